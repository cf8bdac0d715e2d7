"""Contact constraints frozen at one state: gaps that must not be negative, their energy and its multipliers.

Elasticity says how far their forces move a surface's vertices by the PD matrix; with it follows the matrix of energy
and contact together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix, hstack

from ....lhm.base.mesh import Floats, Ints
from ..unknowns.coordinates import Coordinates, Place
from ..unknowns.system import System


@dataclass(frozen=True, eq=False)
class Constraints:
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
    def concatenate(cls, parts: Sequence[Constraints]) -> Constraints:
        """Concatenate the constraints of several."""
        return cls(
            *(np.concatenate([getattr(constraints, field.name) for constraints in parts]) for field in fields(cls))
        )

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

    def select(self, mask: np.ndarray) -> Constraints:
        """Select some of the constraints."""
        return Constraints(*(getattr(self, field.name)[mask] for field in fields(self)))

    def keys(self) -> list[tuple[int, ...]]:
        """What makes a constraint the same at another state: its vertex, or its two edges."""
        edges = self.between_edges.tolist()
        return [(a, b, c, d) if edge else (a,) for (a, b, c, d), edge in zip(self.ids.tolist(), edges, strict=True)]

    def carry_multipliers(self, others: Constraints) -> Constraints:
        """The same constraints with the multipliers of others that have the same keys, 0 where there are none."""
        known = dict(zip(others.keys(), others.multipliers.tolist(), strict=True))
        return replace(self, multipliers=np.array([known.get(key, 0.0) for key in self.keys()]))


COLUMNS = 64
"""Right-hand sides solved for at once."""


class ContactMatrix:
    """A + Σ stiffness c cᵀ over the constraints that push, c being their gaps' gradients (Woodbury)."""

    def __init__(self, system: System, stiffness: Floats, gradients: csr_matrix, compliance: Floats):
        self._system, self._gradients = system, gradients
        self._small = np.diag(1.0 / stiffness) + compliance
        self._pushing = np.zeros(0, dtype=bool)

    def solve(self, vector: Floats, pushing: np.ndarray, rotations: Floats) -> Floats:
        """The inverse times a vector over the unknowns, where the constraints of a mask (r,) push.

        It takes two solves with A, one where nothing pushes, and a small dense factor while the mask is the same.
        """
        moved = self._system.solve(vector, rotations)
        if not pushing.any():
            return moved
        if not np.array_equal(pushing, self._pushing):
            self._pushing = pushing
            self._gradients_pushing = self._gradients[pushing]
            self._factor = cho_factor(self._small[np.ix_(pushing, pushing)])
        forces = cho_solve(self._factor, self._gradients_pushing @ moved)
        return moved - self._system.solve(self._gradients_pushing.T @ forces, rotations)


class Elasticity:
    """The PD matrix as contact feels it: A⁻¹ between some vertices is found when first asked for, and kept."""

    def __init__(self, system: System, vertices: Ints):
        self.system, self._vertices = system, vertices
        self._known = np.zeros(len(vertices), dtype=bool)
        self._blocks = [np.zeros((len(vertices), len(vertices))) for _ in system.groups]

    def compliance(self, constraints: Constraints, place: Place) -> tuple[csr_matrix, Floats]:
        """The gaps' gradients over the unknowns C, shape (r, size), and C A⁻¹ Cᵀ [mm/mN], shape (r, r), at a place."""
        gradients = _gradients(self.system.coordinates, constraints, place)
        return gradients, self._between_vertices(constraints) + self._sum_by_bodies(gradients, place)

    def with_constraints(self, constraints: Constraints, place: Place) -> ContactMatrix:
        """The matrix A with the constraints' own, linearised at a place."""
        return ContactMatrix(self.system, constraints.stiffness, *self.compliance(constraints, place))

    def _between_vertices(self, constraints: Constraints) -> Floats:
        """The part of C A⁻¹ Cᵀ that free vertices have while bodies are held."""
        vertices, local = np.unique(constraints.ids, return_inverse=True)
        at = np.searchsorted(self._vertices, vertices)
        missing = at[~self._known[at]]
        for first in range(0, len(missing), COLUMNS):
            self._find(missing[first : first + COLUMNS])
        r = len(constraints.ids)
        shape = (r, len(vertices))
        weights = csr_matrix((constraints.weights.ravel(), (np.repeat(np.arange(r), 4), local.ravel())), shape=shape)
        total = np.zeros((r, r))
        for (components, _), block in zip(self.system.coordinates.groups, self._blocks, strict=True):
            along = constraints.normals[:, components]
            total += (weights @ (weights @ block[np.ix_(at, at)]).T) * (along @ along.T)
        return total

    def _sum_by_bodies(self, gradients: csr_matrix, place: Place) -> Floats | float:
        """The part that bodies have by giving way."""
        first, size = len(self.system.coordinates.index), self.system.coordinates.size
        if first == size:
            return 0.0
        units = np.eye(size - first, size, first)
        moved = np.stack([self.system.solve(unit, place.rotations) for unit in units], axis=1)
        given = gradients @ moved
        return given @ np.linalg.solve(moved[first:], given.T)

    def _find(self, columns: Ints):
        for block, group, (_, free) in zip(
            self._blocks, self.system.groups, self.system.coordinates.groups, strict=True
        ):
            place = _places(free, self._vertices)
            unit = np.zeros((len(free), len(columns)))
            some = np.flatnonzero(place[columns] >= 0)
            unit[place[columns[some]], some] = 1.0
            moved = group.solver(unit)
            block[:, columns] = np.where(place[:, None] >= 0, moved[place], 0.0)
        self._known[columns] = True


def _places(free: Ints, vertices: Ints) -> Ints:
    """Where each of `vertices` stands in the sorted `free`, -1 if it does not."""
    if not len(free):
        return np.full(len(vertices), -1)
    place = np.minimum(np.searchsorted(free, vertices), len(free) - 1)
    return np.where(free[place] == vertices, place, -1)


def _gradients(coordinates: Coordinates, constraints: Constraints, place: Place) -> csr_matrix:
    """The gaps' gradients over the unknowns, shape (r, size)."""
    r = len(constraints.ids)
    columns = 3 * constraints.ids[:, :, None] + np.arange(3)
    values = constraints.weights[:, :, None] * constraints.normals[:, None, :]
    at = np.repeat(np.arange(r), 12)
    over_x = csr_matrix((values.ravel(), (at, columns.ravel())), shape=(r, place.u.size))
    free = over_x[:, coordinates.index]
    if not coordinates.bodies:
        return free
    motions = np.zeros((r, 6 * len(coordinates.bodies)))
    bound = np.isin(constraints.ids, np.concatenate([body.vertices for body in coordinates.bodies])).any(axis=1)
    for k in np.flatnonzero(bound):
        gradient = over_x[k].toarray().reshape(-1, 3)
        motions[k] = coordinates.pull(gradient, place)[len(coordinates.index) :]
    return hstack([free, motions]).tocsr()
