"""Displacements and pressures as one vector: of each process first the displacements it owns, then the pressures."""

from __future__ import annotations

import numpy as np

from ...lhm.mesh import Floats, Ints
from . import dolfinx_version as seam
from .problem import Problem
from .shared import Shared, anywhere


class Unknowns:
    """A problem's unknowns: `displacements` and then `pressures` are how many of each this process owns.

    `shared` says how processes share them; in a field `of_displacements` (3n,) and `of_pressures` (n_p,) are the places
    of those that this process knows of, in the order of their own fields.
    """

    def __init__(self, problem: Problem):
        nodes = problem.numbering.nodes
        self.problem = problem
        self.displacements, self.pressures = 3 * nodes.owned, 0
        pressure_ids: Ints = np.empty(0, dtype=np.int64)
        if problem.pressure is not None:
            space = problem.pressure.function_space
            self.pressures, pressure_ids = seam.dof_counts(space)[0], seam.global_dofs(space)
        bounds = np.concatenate([[0], np.cumsum(problem.comm.allgather(self.pressures))])
        ghosts, ghost_pressures = nodes.ids[nodes.owned :], pressure_ids[self.pressures :]
        owner = np.searchsorted(nodes.bounds, ghosts, side="right") - 1
        far = (3 * ghosts + bounds[owner])[:, None] + np.arange(3)
        owner = np.searchsorted(bounds, ghost_pressures, side="right") - 1
        far_pressures = 3 * nodes.bounds[owner + 1] + ghost_pressures
        self.count = self.displacements + self.pressures
        self.shared = Shared(problem.comm, self.count, np.concatenate([far.ravel(), far_pressures]), 1)
        ahead = self.count + far.size
        self.of_displacements: Ints = np.concatenate([np.arange(self.displacements), np.arange(self.count, ahead)])
        self.of_pressures: Ints = np.concatenate(
            [np.arange(self.displacements, self.count), np.arange(ahead, ahead + len(far_pressures))]
        )

    def field(self, z: Floats) -> tuple[Floats, Floats]:
        """The displacement (n, 3) and the pressure (n_p,) of a vector z (count,), as fields."""
        known = self.shared.spread(z)
        return known[self.of_displacements].reshape(-1, 3), known[self.of_pressures]

    def summed(self, forces: Floats, volumes: Floats) -> Floats:
        """The vector that all processes' parts by displacement, a field (n, 3), and by pressure (n_p,) add up to."""
        parts = np.empty(self.shared.count)
        parts[self.of_displacements], parts[self.of_pressures] = forces.ravel(), volumes
        return self.shared.summed(parts)

    def idle_pressures(self) -> Ints:
        """The places, in a vector, of pressures that no law has."""
        used = np.zeros(self.shared.count, dtype=bool)
        for forms in self.problem.mixed_forms:
            used[self.of_pressures[self.problem.pressure_dofs[forms.cells].ravel()]] = True
        used = self.shared.marked(used)[: self.count]
        used[: self.displacements] = True
        return np.flatnonzero(~used)

    def any(self, z: Floats) -> bool:
        """Whether any process has a value that is not zero."""
        return anywhere(self.problem.comm, z)
