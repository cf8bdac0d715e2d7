"""Pairs that are near one another: their gaps, forces and energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ....lhm.base.mesh import Floats, Ints


@dataclass(frozen=True, eq=False)
class Rows:
    """Pairs near one another, r of them, and the energy ½ Σ stiffness max(depth, 0)² [µJ] of what is too near.

    ids (r, 4) of the contact vertices and between_edges (r,): the pairs, as of `terms.Gaps`; weights (r, 4) and
    normals (r, 3) of their gaps, see `terms.gaps.measure_pair`; distance and offset (r,) [mm]; stiffness (r,) [mN/mm].
    """

    ids: Ints
    between_edges: np.ndarray
    weights: Floats
    normals: Floats
    distance: Floats
    offset: Floats
    stiffness: Floats

    @cached_property
    def depth(self) -> Floats:
        """The offset less the distance [mm], shape (r,)."""
        return self.offset - self.distance

    @classmethod
    def concatenate(cls, parts: Sequence[Rows]) -> Rows:
        """Concatenate the rows of several surfaces."""
        return cls(*(np.concatenate([getattr(rows, field.name) for rows in parts]) for field in fields(cls)))

    def select(self, which: Ints) -> Rows:
        """Select some rows."""
        return Rows(*(getattr(self, field.name)[which] for field in fields(self)))

    @property
    def energy(self) -> float:
        """The energy [µJ]."""
        return float(0.5 * np.sum(self.stiffness * np.maximum(self.depth, 0.0) ** 2))

    @property
    def forces(self) -> Floats:
        """The forces [mN], shape (r,), that push each pair apart."""
        return self.stiffness * np.maximum(self.depth, 0.0)

    def spread(self, forces: Floats, count: int) -> Floats:
        """Spread forces (r,) along the gaps over the contact vertices, shape (count, 3)."""
        pushes = (forces[:, None] * self.weights)[:, :, None] * self.normals[:, None, :]
        ids = self.ids.ravel()
        return np.stack([np.bincount(ids, pushes[..., c].ravel(), count) for c in range(3)], axis=1)

    def widen(self, motion: Floats) -> Floats:
        """Tell by how much a motion (k, 3) [mm] widens each gap, shape (r,)."""
        return np.einsum("rj,rjc,rc->r", self.weights, motion[self.ids], self.normals)
