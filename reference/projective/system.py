"""The PD matrix A = Σ w G Gᵀ over free vertices, and its factorisation: the global step, and a preconditioner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ...lhm.errors import SceneError
from ...lhm.geometry.factor import factorise
from ...lhm.mesh import Floats, Ints

Solver = Callable[[Floats], Floats]

# Relative diagonal shift of parts that nothing holds, whose matrix is singular. It changes the steps, not the answer.
SHIFT = 1e-7


@dataclass(frozen=True, eq=False)
class Group:
    """Components (of x, y, z) that are held at the same vertices, so that one factorisation serves them."""

    components: Ints
    free: Ints
    solver: Solver
    loose: Ints


@dataclass(frozen=True, eq=False)
class System:
    """A⁻¹ on the free components, one factorisation per different set of held vertices."""

    groups: tuple[Group, ...]
    free: np.ndarray

    @classmethod
    def of(cls, matrix: csr_matrix, anchored: np.ndarray, held: np.ndarray) -> System:
        """From the matrix (n, n) [mN/mm], the vertices that a Target holds (n,), and held components (n, 3)."""
        _, part = connected_components(matrix, directed=False)
        groups = []
        for components in _alike(held):
            free = np.flatnonzero(~held[:, components[0]])
            if not len(free):
                continue
            is_tied = np.zeros(part.max() + 1, dtype=bool)
            is_tied[part[anchored | held[:, components[0]]]] = True
            loose = np.where(is_tied[part], -1, part)
            reduced = matrix[free][:, free].tocsr()
            diagonal = reduced.diagonal()
            shift = np.where(loose[free] >= 0, SHIFT * diagonal, 0.0)
            shift[diagonal == 0] = 1.0
            reduced = (reduced + csr_matrix((shift, (np.arange(len(free)),) * 2), shape=reduced.shape)).tocsc()
            groups.append(Group(components, free, factorise(reduced), loose))
        return cls(tuple(groups), ~held)

    def check_loads(self, loads: Floats):
        """Raise SceneError for a part that nothing holds although forces [mN], shape (n, 3), push it somewhere."""
        for group in self.groups:
            loose = group.loose >= 0
            if not loose.any():
                continue
            for c in group.components:
                net = np.bincount(group.loose[loose], loads[loose, c])
                size = np.bincount(group.loose[loose], np.abs(loads[loose, c]))
                bad = np.flatnonzero(np.abs(net) > 1e-9 * size)
                if bad.size:
                    vertex = np.flatnonzero(group.loose == bad[0])[0]
                    raise SceneError(
                        f"nothing holds the part around vertex {vertex} along {'xyz'[c]}, where loads of "
                        f"{net[bad[0]]:.3g} mN push it: add Fixed or Target, or balance the loads"
                    )

    def solve(self, gradient: Floats) -> Floats:
        """A⁻¹ times the gradient (n, 3); zero in held components."""
        step = np.zeros_like(gradient)
        for group in self.groups:
            where = np.ix_(group.free, group.components)
            step[where] = group.solver(np.ascontiguousarray(gradient[where]))
        return step


def _alike(held: np.ndarray) -> list[Ints]:
    """The components of x, y, z, gathered by equal columns of `held`."""
    gathered: dict[bytes, list[int]] = {}
    for c in range(3):
        gathered.setdefault(held[:, c].tobytes(), []).append(c)
    return [np.array(components) for components in gathered.values()]
