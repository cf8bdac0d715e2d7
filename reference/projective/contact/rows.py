"""Contact constraints frozen at one state: gaps that must not be negative, their energy and its multipliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ....lhm.base.mesh import Floats, Ints


@dataclass(frozen=True, eq=False)
class Rows:
    """Gaps g = n · Σ_j weight_j x_j - thickness >= 0, r of them, each between two points of the surface.

    ids (r, 4): vertices of the scene; weights (r, 4), summing to zero: a vertex against a triangle (1, -b₀, -b₁, -b₂)
    or a point of an edge against one of another (1 - s, s, t - 1, -t); normals (r, 3): unit, from the second to the
    first; thickness (r,) [mm]; stiffness (r,) [mN/mm]; multipliers (r,) [mN], at least 0: the forces needed so far.
    """

    ids: Ints
    weights: Floats
    normals: Floats
    stiffness: Floats
    thickness: Floats
    multipliers: Floats

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """The constraints of several, in order."""
        return cls(*(np.concatenate([getattr(rows, field.name) for rows in parts]) for field in fields(cls)))

    @property
    def between_edges(self) -> np.ndarray:
        """Which constraints are between two edges, shape (r,)."""
        return self.weights[:, 0] != 1.0

    def gaps(self, x: Floats) -> Floats:
        """Gaps [mm], shape (r,), at positions x [mm], shape (n, 3)."""
        return np.einsum("rj,rjc,rc->r", self.weights, x[self.ids], self.normals) - self.thickness

    def forces(self, x: Floats) -> Floats:
        """Forces [mN], shape (r,), with which the constraints push their two points apart along the normals."""
        return np.maximum(self.multipliers - self.stiffness * self.gaps(x), 0.0)

    def add_to(self, x: Floats, gradient: Floats) -> float:
        """Add the gradient [mN] to (n, 3) and return the energy [µJ] of the augmented Lagrangian.

        Σ (f² - multiplier²) / (2 stiffness) with f the forces (Nocedal and Wright 2006, Eq. 17.50 for inequalities): a
        penalty stiffness/2 min(g, 0)² where the multiplier is zero.
        """
        forces = self.forces(x)
        pushes = -(forces[:, None] * self.weights)[:, :, None] * self.normals[:, None, :]
        np.add.at(gradient, self.ids.ravel(), pushes.reshape(-1, 3))
        return float(np.sum((forces**2 - self.multipliers**2) / (2.0 * self.stiffness)))

    def updated(self, x: Floats) -> Rows:
        """The same constraints with the forces at x for multipliers."""
        return replace(self, multipliers=self.forces(x))

    def chosen(self, mask: np.ndarray) -> Rows:
        """Some of the constraints."""
        return Rows(*(getattr(self, field.name)[mask] for field in fields(self)))

    def keys(self) -> list[tuple[int, ...]]:
        """What makes a constraint the same at another state: its vertex, or its two edges."""
        edges = self.between_edges.tolist()
        return [(a, b, c, d) if edge else (a,) for (a, b, c, d), edge in zip(self.ids.tolist(), edges, strict=True)]

    def carrying(self, others: Rows) -> Rows:
        """The same constraints with the multipliers of others that have the same keys, 0 where there are none."""
        known = dict(zip(others.keys(), others.multipliers.tolist(), strict=True))
        return replace(self, multipliers=np.array([known.get(key, 0.0) for key in self.keys()]))
