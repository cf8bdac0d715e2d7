"""The model of elasticity that contact is solved in: A⁻¹ and the memory of L-BFGS, on the contact points.

B⁻¹ = A⁻¹ + U M Uᵀ is the inverse of L-BFGS in compact form (Byrd, Nocedal and Schnabel 1994, Theorem 2.2), with the PD
matrix A at the bodies' first rotations as its start. P takes the contact points' motion from a step over unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.sparse import csr_matrix

from ....lhm.base.mesh import Floats, Ints
from ..memory import CAPACITY
from ..unknowns.coordinates import Coordinates
from ..unknowns.system import System
from .points import ContactPoints, restrict
from .rows import Rows

COLUMNS = 64
"""Right-hand sides solved for at once."""


class Compliance:
    """The inverse of A between contact vertices while bodies are held, a block per group of components, (k, k).

    A column is found when it is first asked for, and kept: preparing all of a face's costs as much as three frames.
    Contact points beyond the vertices are of obstacles, which do not move while bodies are held.
    """

    def __init__(self, system: System, vertices: Ints):
        self._system, self._vertices = system, vertices
        self._known = np.zeros(len(vertices), dtype=bool)
        self._blocks = [np.zeros((len(vertices), len(vertices))) for _ in system.groups]

    def push(self, forces: Floats) -> Floats:
        """Return the motion [mm] of all contact points under forces (k + o, 3) [mN] on some."""
        count = len(self._vertices)
        pushed = np.flatnonzero(np.any(forces[:count] != 0.0, axis=1))
        motion = np.zeros_like(forces)
        for components, block in self._find(pushed):
            motion[:count, components] = block[pushed].T @ forces[np.ix_(pushed, components)]
        return motion

    def between(self, rows: Rows) -> Floats:
        """Return how much the force of each row widens each gap [mm/mN], shape (r, r)."""
        count, is_vertex = len(rows.ids), rows.ids < len(self._vertices)
        vertices, local = np.unique(rows.ids[is_vertex], return_inverse=True)
        entries = rows.weights[is_vertex], (np.nonzero(is_vertex)[0], local)
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
        points: ContactPoints,
        rotations: Floats,
    ):
        self.solve_start, self._compliance = solve_start, compliance
        self._coordinates, self._points = coordinates, points
        size, free = coordinates.size, len(coordinates.index)
        self._restriction = restrict(coordinates, points.vertices, rotations)
        self._carrying = points.carry(coordinates, rotations)
        self._of_bodies: list[tuple[Floats, Floats]] = []
        if size > free:
            self._bodies_solved = np.stack([self.solve_start(unit) for unit in np.eye(size - free, size, free)])
            giving = self._bodies_solved[:, free:]
            near = np.stack([self._restrict(step) for step in self._bodies_solved])
            self._of_bodies.append((near, np.linalg.inv(0.5 * (giving + giving.T))))
        self._steps, self._changes, self._solved = (np.zeros((CAPACITY, size)) for _ in range(3))
        self._near = np.zeros((2 * CAPACITY, 3 * len(points)))
        self._products, self._own = np.zeros((CAPACITY, CAPACITY)), np.zeros((CAPACITY, CAPACITY))
        self.clear()

    def turn(self, rotations: Floats):
        """Carry obstacles by bodies that have these rotations; A and the vertices' part of P stay."""
        self._carrying = self._points.carry(self._coordinates, rotations)
        own, free = self._restriction.shape[0], len(self._coordinates.index)
        for near, _ in self._of_bodies:
            near[:, own:] = self._bodies_solved[:, free:] @ self._carrying.T
        remembered = np.vstack([self._steps[:, free:], self._solved[:, free:]])
        self._near[:, own:] = remembered @ self._carrying.T

    def _restrict(self, step: Floats) -> Floats:
        """Return P times a step (size,)."""
        return np.concatenate([self._restriction @ step, self._carrying @ step[len(self._coordinates.index) :]])

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
        return (self._restrict(solved) + (self._small @ seen) @ self._near).reshape(-1, 3)

    def spread(self, forces: Floats) -> Floats:
        """Return forces (k, 3) on the contact vertices as a vector over the unknowns (size,)."""
        own = len(self._points.vertices)
        spread = self._restriction.T @ forces[:own].ravel()
        spread[len(self._coordinates.index) :] += self._carrying.T @ forces[own:].ravel()
        return spread

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
        self._near[slot], self._near[CAPACITY + slot] = self._restrict(step), self._restrict(solved)
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
