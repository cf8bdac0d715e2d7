"""Springs that pull vertices to places, and dead loads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, tril

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Target
from ...terms.term import triangle_areas
from .local_step import COMPILED
from .part import Part


@dataclass(frozen=True, eq=False)
class Springs(Part):
    """Per term vertices (k,), displacements [mm] (k, 3) that draw them, and a matrix [mN/mm] (k, k).

    There are always Springs, if only of no vertices.
    """

    drawn: tuple[tuple[Ints, Floats, csr_matrix], ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Springs:
        springs = cls(tuple((term.vertices, term.positions, _matrix(term, scene)) for term in scene.of(Target)))
        return springs.for_scene(scene)

    def for_scene(self, scene: Scene) -> Springs:
        return Springs(
            tuple(
                (vertices, term.positions - scene.vertices[vertices], matrix)
                for (vertices, _, matrix), term in zip(self.drawn, scene.of(Target), strict=True)
            )
        )

    def shift(self, moved: Floats) -> Springs:
        """Move the first term's places by `moved` [mm], shape (k, 3)."""
        (vertices, displacements, matrix), *others = self.drawn
        return Springs(((vertices, displacements + moved, matrix), *others))

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        for vertices, displacements, matrix in self.drawn:
            rows = (matrix.indptr, matrix.indices, matrix.data)
            total += _add_springs(vertices, displacements, *rows, u, gradient)
        return total

    def add_anchors(self, anchored: Floats):
        for vertices, _, matrix in self.drawn:
            anchored[vertices] += matrix.diagonal()

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """See Part; the diagonal is whole, whatever is drawn."""
        every = np.arange(len(scene.vertices))
        entries = [(every, every, np.zeros(len(every)))]
        for vertices, _, matrix in self.drawn:
            joined = matrix.tocoo()
            entries.append((vertices[joined.row], vertices[joined.col], joined.data))
        rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
        return rows, columns, values

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        return tuple(array for vertices, _, matrix in self.drawn for array in (vertices, matrix.indptr, matrix.indices))

    def pairs(self, scene: Scene) -> Ints:
        """See Part; each vertex with itself, all of them, then what springs join."""
        itself = np.repeat(np.arange(len(scene.vertices)), 2).reshape(-1, 2)
        joined = (vertices[np.column_stack([lower.row, lower.col])] for vertices, lower in self._lower())
        return np.concatenate([itself, *joined])

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        begin = len(u)
        for _, lower in self._lower():
            own = slots[begin : begin + lower.nnz]
            begin += lower.nnz
            for r in range(3):
                blocks[own, r, r] += lower.data

    def _lower(self) -> list[tuple[Ints, coo_matrix]]:
        """Each term's vertices, and the lower half of its matrix with the diagonal."""
        return [(vertices, tril(matrix, format="coo")) for vertices, _, matrix in self.drawn]


def _matrix(term: Target, scene: Scene) -> csr_matrix:
    """Return the matrix [mN/mm], shape (k, k), of a term's springs: diagonal but for those that are spread.

    Of a density that is linear on a triangle, ∫ ρ N_a N_b = A (Σ ρ + ρ_a + ρ_b) (1 + δ_ab) / 60.
    """
    k = len(term.vertices)
    stiffness = np.broadcast_to(term.stiffness, k)
    alone, own, triangles = np.ones(k, dtype=bool), np.empty((0, 3), dtype=np.int64), np.zeros((0, 3, 3))
    if term.is_spread(1):
        alone, density, _ = term.spread(scene)
        number = np.zeros(len(scene.vertices), dtype=np.int64)
        number[term.vertices] = np.arange(k)
        own = number[term.triangles]
        sums = density.sum(axis=1)[:, None, None] + density[:, :, None] + density[:, None]
        triangles = triangle_areas(scene.vertices, term.triangles)[:, None, None] / 60.0 * sums * (1.0 + np.eye(3))
    every = np.arange(k)
    values = np.concatenate([np.where(alone, stiffness, 0.0), triangles.ravel()])
    rows = np.concatenate([every, np.repeat(own, 3, axis=1).ravel()])
    columns = np.concatenate([every, np.tile(own, (1, 3)).ravel()])
    return csr_matrix((values, (rows, columns)), shape=(k, k))


@njit(**COMPILED)
def _add_springs(vertices, displacements, starts, others, stiffness, u, gradient):
    """Add the springs' gradient in place; return their energy."""
    away = np.empty_like(displacements)
    for k in range(len(vertices)):
        for r in range(3):
            away[k, r] = u[vertices[k], r] - displacements[k, r]
    energy = 0.0
    for k in range(len(vertices)):
        f0, f1, f2 = 0.0, 0.0, 0.0
        for j in range(starts[k], starts[k + 1]):
            weight, other = stiffness[j], others[j]
            f0 += weight * away[other, 0]
            f1 += weight * away[other, 1]
            f2 += weight * away[other, 2]
        gradient[vertices[k], 0] += f0
        gradient[vertices[k], 1] += f1
        gradient[vertices[k], 2] += f2
        energy += 0.5 * (f0 * away[k, 0] + f1 * away[k, 1] + f2 * away[k, 2])
    return energy


@dataclass(frozen=True, eq=False)
class DeadLoads(Part):
    """Forces [mN], shape (n, 3), whose energy is -f·u. There are always DeadLoads, if only of zero."""

    forces: Floats

    @cached_property
    def is_zero(self) -> bool:
        """Whether nothing pushes."""
        return not self.forces.any()

    @classmethod
    def from_scene(cls, scene: Scene) -> DeadLoads:
        return cls(scene.loads())

    def for_scene(self, scene: Scene) -> DeadLoads:
        return DeadLoads.from_scene(scene)

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        if self.is_zero:
            return total
        gradient -= self.forces
        return total - float(np.vdot(self.forces, u))
