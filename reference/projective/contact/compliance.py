"""How far forces move a surface's vertices by the PD matrix, and with it the matrix of energy and contact together."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix, hstack

from ....lhm.base.mesh import Floats, Ints
from ..coordinates import Coordinates, Place
from ..system import System
from .rows import Rows

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

    def of(self, rows: Rows, place: Place) -> tuple[csr_matrix, Floats]:
        """The gaps' gradients over the unknowns C, shape (r, size), and C A⁻¹ Cᵀ [mm/mN], shape (r, r), at a place."""
        gradients = _gradients(self.system.coordinates, rows, place)
        return gradients, self._between_vertices(rows) + self._by_bodies(gradients, place)

    def with_rows(self, rows: Rows, place: Place) -> ContactMatrix:
        """The matrix A with the constraints' own, linearised at a place."""
        return ContactMatrix(self.system, rows.stiffness, *self.of(rows, place))

    def _between_vertices(self, rows: Rows) -> Floats:
        """The part of C A⁻¹ Cᵀ that free vertices have while bodies are held."""
        vertices, local = np.unique(rows.ids, return_inverse=True)
        at = np.searchsorted(self._vertices, vertices)
        missing = at[~self._known[at]]
        for first in range(0, len(missing), COLUMNS):
            self._find(missing[first : first + COLUMNS])
        r = len(rows.ids)
        shape = (r, len(vertices))
        weights = csr_matrix((rows.weights.ravel(), (np.repeat(np.arange(r), 4), local.ravel())), shape=shape)
        total = np.zeros((r, r))
        for (components, _), block in zip(self.system.coordinates.groups, self._blocks, strict=True):
            along = rows.normals[:, components]
            total += (weights @ (weights @ block[np.ix_(at, at)]).T) * (along @ along.T)
        return total

    def _by_bodies(self, gradients: csr_matrix, place: Place) -> Floats | float:
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


def _gradients(coordinates: Coordinates, rows: Rows, place: Place) -> csr_matrix:
    """The gaps' gradients over the unknowns, shape (r, size)."""
    r = len(rows.ids)
    columns = 3 * rows.ids[:, :, None] + np.arange(3)
    values = rows.weights[:, :, None] * rows.normals[:, None, :]
    at = np.repeat(np.arange(r), 12)
    over_x = csr_matrix((values.ravel(), (at, columns.ravel())), shape=(r, place.u.size))
    free = over_x[:, coordinates.index]
    if not coordinates.bodies:
        return free
    motions = np.zeros((r, 6 * len(coordinates.bodies)))
    bound = np.isin(rows.ids, np.concatenate([body.vertices for body in coordinates.bodies])).any(axis=1)
    for k in np.flatnonzero(bound):
        gradient = over_x[k].toarray().reshape(-1, 3)
        motions[k] = coordinates.pull(gradient, place)[len(coordinates.index) :]
    return hstack([free, motions]).tocsr()
