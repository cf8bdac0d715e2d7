"""The pattern of the Hessian over the unknowns, and where each of its entries comes from.

The Hessian over vertices is a block (3, 3) per pair of vertices that some energy joins, kept once, with the rows of the
higher vertex. A body's six rows are its vertices' rows, carried over to shift and turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ..terms.local_step import COMPILED
from ..terms.part import Part
from .coordinates import Coordinates


@dataclass(frozen=True, eq=False)
class Sparsity:
    """Blocks of pairs of vertices (pairs, 2), higher one first, and those that the elements of each part add to.

    `source` says for each entry of the matrix (in CSC's order) where it stands in the flat blocks, behind which the
    bodies' dense rows (6 bodies, size) follow.
    """

    elements: tuple[Ints, ...]
    pairs: Ints
    slots: tuple[Ints, ...]
    indices: Ints
    indptr: Ints
    source: Ints

    @classmethod
    def from_scene(cls, scene: Scene, parts: Sequence[Part], coordinates: Coordinates) -> Sparsity:
        """Find the pattern of a scene's energy over its unknowns."""
        n = len(scene.vertices)
        joined = [part.pairs(scene) for part in parts]
        keys = [np.max(ends, axis=1) * n + np.min(ends, axis=1) for ends in joined]
        known = np.unique(np.concatenate(keys))
        slots = tuple(np.searchsorted(known, key) for key in keys)
        pairs = np.column_stack([known // n, known % n])
        elements = _elements_of(scene, parts, coordinates)
        return cls(elements, pairs, slots, *_entries(pairs, n, coordinates))

    def fits(self, scene: Scene, parts: Sequence[Part], coordinates: Coordinates) -> bool:
        """Whether this is the pattern of a scene's energy over its unknowns."""
        elements = _elements_of(scene, parts, coordinates)
        same = len(self.slots) == len(parts) and len(self.elements) == len(elements)
        return same and all(map(np.array_equal, self.elements, elements))

    def matrix(self, blocks: Floats, bodies: Floats) -> csc_matrix:
        """Assemble the matrix (size, size) [mN/mm] of blocks (pairs, 3, 3) and bodies' rows (6 bodies, size)."""
        flat = np.concatenate([blocks.ravel(), bodies.ravel()])
        size = len(self.indptr) - 1
        return csc_matrix((flat[self.source], self.indices, self.indptr), shape=(size, size))


def _elements_of(scene: Scene, parts: Sequence[Part], coordinates: Coordinates) -> tuple[Ints, ...]:
    """Return all that the pattern follows from: who joins whom, and which components are unknowns."""
    elements = (array for part in parts for array in part.elements(scene))
    return (*elements, coordinates.index, *(body.vertices for body in coordinates.bodies))


@njit(**COMPILED)
def add_block(blocks, slot, block, transposed):
    """Add a 3x3 block, or its transpose."""
    for r in range(3):
        for c in range(3):
            blocks[slot, r, c] += block[c, r] if transposed else block[r, c]


def _entries(pairs: Ints, n: int, coordinates: Coordinates) -> tuple[Ints, Ints, Ints]:
    """Find CSC's indices and indptr, and where each entry comes from."""
    size, free = coordinates.size, len(coordinates.index)
    unknown = np.full(3 * n, -1)
    unknown[coordinates.index] = np.arange(free)
    row = unknown[(3 * pairs[:, 0, None, None] + np.arange(3)[:, None]) + np.zeros(3, np.int64)].reshape(-1)
    column = unknown[(3 * pairs[:, 1, None, None] + np.arange(3)) + np.zeros((3, 1), np.int64)].reshape(-1)
    kept = np.flatnonzero((row >= 0) & (column >= 0))
    mirrored = kept[np.repeat(pairs[:, 0] != pairs[:, 1], 9)[kept]]
    rows = [row[kept], column[mirrored]]
    columns = [column[kept], row[mirrored]]
    sources = [kept, mirrored]
    begin = 9 * len(pairs)
    near = _near_bodies(pairs, n, coordinates)
    for line in range(6 * len(coordinates.bodies)):
        beside = np.flatnonzero(near[line // 6])
        at = begin + line * size + beside
        rows += [np.full(len(beside), free + line), beside[beside < free]]
        columns += [beside, np.full(np.count_nonzero(beside < free), free + line)]
        sources += [at, at[beside < free]]
    where = np.concatenate(sources)
    placed = coo_matrix((where + 1, (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)).tocsc()
    placed.sort_indices()
    return placed.indices.astype(np.int32), placed.indptr.astype(np.int32), placed.data - 1


def _near_bodies(pairs: Ints, n: int, coordinates: Coordinates) -> np.ndarray:
    """Mask the unknowns that each body is joined to, shape (bodies, size); its own six are."""
    free, count = len(coordinates.index), len(coordinates.bodies)
    owner = np.full(n, -1)
    near = np.zeros((count, coordinates.size), dtype=bool)
    for b, body in enumerate(coordinates.bodies):
        owner[body.vertices] = b
    for b in range(count):
        beside = np.zeros(n, dtype=bool)
        for one, other in ((0, 1), (1, 0)):
            beside[pairs[owner[pairs[:, one]] == b, other]] = True
        near[b, :free] = beside[coordinates.index // 3]
        for c in np.unique(owner[beside & (owner >= 0)]):
            near[b, free + 6 * c : free + 6 * c + 6] = True
        near[b, free + 6 * b : free + 6 * b + 6] = True
    mirrored = np.zeros_like(near)
    for b in range(count):
        for c in range(count):
            mirrored[b, free + 6 * c : free + 6 * c + 6] = near[c, free + 6 * b]
    return near | mirrored
