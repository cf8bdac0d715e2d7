"""The model of elasticity that contact is solved in: A⁻¹ and the memory of L-BFGS, on the contact vertices.

B⁻¹ = A⁻¹ + U M Uᵀ is the inverse of L-BFGS in compact form (Byrd, Nocedal and Schnabel 1994, Theorem 2.2), with the PD
matrix A at the bodies' first rotations as its start. P takes the contact vertices' motion from a step over unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.sparse import csr_matrix

from ....lhm.base.mesh import Floats, Ints
from ..memory import CAPACITY
from ..unknowns.coordinates import CROSS, Coordinates
from ..unknowns.system import System
from .surfaces import Rows

COLUMNS = 64
"""Right-hand sides solved for at once."""


class Compliance:
    """The inverse of A between contact vertices while bodies are held, a block per group of components, (k, k).

    A column is found when it is first asked for, and kept: preparing all of a face's costs as much as three frames.
    """

    def __init__(self, system: System, vertices: Ints):
        self._system, self._vertices = system, vertices
        self._known = np.zeros(len(vertices), dtype=bool)
        self._blocks = [np.zeros((len(vertices), len(vertices))) for _ in system.groups]

    def push(self, forces: Floats) -> Floats:
        """Return the motion [mm] of all contact vertices under forces (k, 3) [mN] on some."""
        pushed = np.flatnonzero(np.any(forces != 0.0, axis=1))
        motion = np.zeros_like(forces)
        for components, block in self._find(pushed):
            motion[:, components] = block[pushed].T @ forces[np.ix_(pushed, components)]
        return motion

    def between(self, rows: Rows) -> Floats:
        """Return how much the force of each row widens each gap [mm/mN], shape (r, r)."""
        count = len(rows.ids)
        vertices, local = np.unique(rows.ids, return_inverse=True)
        entries = rows.weights.ravel(), (np.repeat(np.arange(count), 4), local.ravel())
        weights = csr_matrix(entries, shape=(count, len(vertices)))
        total = np.zeros((count, count))
        for components, block in self._find(vertices):
            along = rows.normals[:, components]
            total += (weights @ (weights @ block[np.ix_(vertices, vertices)]).T) * (along @ along.T)
        return total

    def _find(self, columns: Ints) -> Sequence[tuple[Ints, Floats]]:
        """Return each group's components and block, whose columns are known."""
        missing = columns[~self._known[columns]]
        for first in range(0, len(missing), COLUMNS):
            self._solve_for(missing[first : first + COLUMNS])
        groups = self._system.coordinates.groups
        return [(components, block) for (components, _), block in zip(groups, self._blocks, strict=True)]

    def _solve_for(self, columns: Ints):
        for block, group, (_, free) in zip(
            self._blocks, self._system.groups, self._system.coordinates.groups, strict=True
        ):
            place = _find_places(free, self._vertices)
            unit = np.zeros((len(free), len(columns)))
            some = np.flatnonzero(place[columns] >= 0)
            unit[place[columns[some]], some] = 1.0
            solved = group.solver(unit) if len(free) else unit
            found = np.where(place[:, None] >= 0, solved[place] if len(free) else 0.0, 0.0)
            block[columns] = found.T
        self._known[columns] = True


def _find_places(free: Ints, vertices: Ints) -> Ints:
    """Find where each of `vertices` stands in the sorted `free`, -1 if it does not."""
    if not len(free):
        return np.full(len(vertices), -1)
    place = np.minimum(np.searchsorted(free, vertices), len(free) - 1)
    return np.where(free[place] == vertices, place, -1)


class Model:
    """B⁻¹ and P, at one start's rotations of the bodies; `solve_start` is A⁻¹ on a vector (size,) there."""

    def __init__(
        self,
        solve_start: Callable[[Floats], Floats],
        coordinates: Coordinates,
        compliance: Compliance,
        vertices: Ints,
        rotations: Floats,
    ):
        self.solve_start, self._compliance = solve_start, compliance
        size, free = coordinates.size, len(coordinates.index)
        self._restriction = restrict(coordinates, vertices, rotations)
        self._of_bodies: list[tuple[Floats, Floats]] = []
        if size > free:
            solved = np.stack([self.solve_start(unit) for unit in np.eye(size - free, size, free)])
            giving = solved[:, free:]
            near = np.stack([self._restriction @ step for step in solved])
            self._of_bodies.append((near, np.linalg.inv(0.5 * (giving + giving.T))))
        self._steps, self._changes, self._solved = (np.zeros((CAPACITY, size)) for _ in range(3))
        self._near = np.zeros((2 * CAPACITY, 3 * len(vertices)))
        self._products, self._own = np.zeros((CAPACITY, CAPACITY)), np.zeros((CAPACITY, CAPACITY))
        self.clear()

    def solve(self, vector: Floats, solved: Floats) -> Floats:
        """Return B⁻¹ times a vector (size,), given A⁻¹ times it."""
        if not self._order:
            return solved
        seen = np.concatenate([self._steps @ vector, self._solved @ vector])
        steps, changes = np.split(self._small @ seen, 2)
        return solved + steps @ self._steps + changes @ self._solved

    def restrict_solution(self, vector: Floats, solved: Floats) -> Floats:
        """Return P B⁻¹ times a vector (size,), given A⁻¹ times it: the contact vertices' motion (k, 3)."""
        seen = np.concatenate([self._steps @ vector, self._solved @ vector])
        return (self._restriction @ solved + (self._small @ seen) @ self._near).reshape(-1, 3)

    def spread(self, forces: Floats) -> Floats:
        """Return forces (k, 3) on the contact vertices as a vector over the unknowns (size,)."""
        return self._restriction.T @ forces.ravel()

    def push(self, forces: Floats) -> Floats:
        """Return P B⁻¹ Pᵀ times forces (k, 3) [mN]: the motion [mm], shape (k, 3)."""
        motion = self._compliance.push(forces)
        for near, small in (*self._of_bodies, (self._near, self._small)):
            motion += ((small @ (near @ forces.ravel())) @ near).reshape(motion.shape)
        return motion

    def between(self, rows: Rows) -> Floats:
        """Return how much the force of each row widens each gap [mm/mN], shape (r, r)."""
        total = self._compliance.between(rows)
        gaps = rows.weights[:, :, None] * rows.normals[:, None, :]
        for near, small in (*self._of_bodies, (self._near, self._small)):
            widened = np.einsum("rjc,brjc->rb", gaps, near.reshape(len(near), -1, 3)[:, rows.ids], optimize=True)
            total += widened @ small @ widened.T
        return total

    def clear(self):
        """Forget all pairs."""
        self._order: list[int] = []
        self._small = np.zeros((2 * CAPACITY, 2 * CAPACITY))

    @property
    def is_empty(self) -> bool:
        """Whether no pair is remembered: B is A."""
        return not self._order

    def add(self, step: Floats, change: Floats, solved: Floats):
        """Remember a step, the change of elasticity's gradient along it and A⁻¹ times that; see `Memory.add`."""
        if not step @ change > 1e-10 * np.linalg.norm(step) * np.linalg.norm(change):
            return
        slot = self._order.pop(0) if len(self._order) == CAPACITY else len(self._order)
        self._order.append(slot)
        self._steps[slot], self._changes[slot], self._solved[slot] = step, change, solved
        self._near[slot], self._near[CAPACITY + slot] = self._restriction @ step, self._restriction @ solved
        self._products[slot], self._products[:, slot] = self._changes @ step, self._steps @ change
        self._own[slot] = self._own[:, slot] = self._solved @ change
        order = np.array(self._order)
        kept = np.ix_(order, order)
        upper = np.linalg.inv(np.triu(self._products[kept]))
        diagonal = np.diag(np.diag(self._products[kept]))
        corner = upper.T @ (diagonal + self._own[kept]) @ upper
        both = np.concatenate([order, CAPACITY + order])
        self._small = np.zeros((2 * CAPACITY, 2 * CAPACITY))
        self._small[np.ix_(both, both)] = np.block([[corner, -upper.T], [-upper, np.zeros_like(corner)]])


def restrict(coordinates: Coordinates, vertices: Ints, rotations: Floats) -> csr_matrix:
    """Return P, shape (3 k, size): the motion of vertices (k,) by a small step, where bodies have these rotations."""
    parts = 3 * vertices[:, None] + np.arange(3)
    unknown = np.full(3 * len(coordinates.held), -1)
    unknown[coordinates.index] = np.arange(len(coordinates.index))
    column = unknown[parts.ravel()]
    rows = np.flatnonzero(column >= 0)
    columns, values = [column[rows]], [np.ones(len(rows))]
    at = [rows]
    for b, (body, rotation) in enumerate(zip(coordinates.bodies, rotations, strict=True)):
        place = np.full(len(coordinates.held), -1)
        place[body.vertices] = np.arange(len(body.vertices))
        of_body = np.flatnonzero(place[vertices] >= 0)
        arms = body.arms[place[vertices[of_body]]] @ rotation.T
        motion = np.concatenate([np.tile(np.eye(3), (len(arms), 1, 1)), np.einsum("imj,km->kij", CROSS, arms)], axis=2)
        first = len(coordinates.index) + 6 * b
        rows, places = np.broadcast_arrays((3 * of_body[:, None] + np.arange(3))[:, :, None], first + np.arange(6))
        at.append(rows.ravel())
        columns.append(places.ravel())
        values.append(motion.ravel())
    entries = np.concatenate(values), (np.concatenate(at), np.concatenate(columns))
    return csr_matrix(entries, shape=(3 * len(vertices), coordinates.size))
