"""The pattern of the Hessian over the unknowns, and where each of its entries comes from.

The Hessian over vertices is a block (3, 3) per pair of vertices that some energy joins, kept once, with the rows of the
higher vertex. A body's six rows are its vertices' rows, carried over to shift and turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.sparse import coo_matrix, csc_matrix

from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from .bending import Rings
from .coordinates import Coordinates, Place
from .energy import Energy
from .tets import PAIRS as TET_PAIRS
from .triangles import PAIRS as TRIANGLE_PAIRS


@dataclass(frozen=True, eq=False)
class Sparsity:
    """Blocks of pairs of vertices (pairs, 2), higher one first, and the blocks that elements add to.

    `source` says for each entry of the matrix (in CSC's order) where it stands in the flat blocks, behind which the
    bodies' dense rows (6 bodies, size) follow.
    """

    elements: tuple[Ints, ...]
    pairs: Ints
    diagonal: Ints
    tets: Ints
    triangles: Ints
    rings: Ints
    first: Ints
    indices: Ints
    indptr: Ints
    source: Ints

    @classmethod
    def from_scene(cls, scene: Scene, energy: Energy, coordinates: Coordinates) -> Sparsity:
        """The pattern of a scene's energy over its unknowns."""
        n = len(scene.vertices)
        tets = np.zeros((0, 4), np.int64) if energy.tets is None else scene.tets[energy.tets.tets]
        triangles = np.zeros((0, 3), np.int64) if energy.triangles is None else energy.triangles.corners
        joined = [
            np.repeat(np.arange(n), 2).reshape(-1, 2),
            tets[:, TET_PAIRS].reshape(-1, 2),
            triangles[:, TRIANGLE_PAIRS].reshape(-1, 2),
        ]
        first = np.zeros(1, np.int64)
        if energy.bending is not None:
            among, first = _ring_pairs(energy.bending)
            joined.append(among)
        keys = [np.max(ends, axis=1) * n + np.min(ends, axis=1) for ends in joined]
        known = np.unique(np.concatenate(keys))
        slots = [np.searchsorted(known, key) for key in keys]
        pairs = np.column_stack([known // n, known % n])
        return cls(
            elements_of(scene, energy, coordinates),
            pairs,
            slots[0],
            slots[1].reshape(len(tets), len(TET_PAIRS)),
            slots[2].reshape(len(triangles), len(TRIANGLE_PAIRS)),
            slots[3] if len(slots) > 3 else np.zeros(0, np.int64),
            first,
            *_entries(pairs, n, coordinates),
        )

    def fits(self, elements: tuple[Ints, ...]) -> bool:
        """Whether this is the pattern of these `elements_of` a scene."""
        return all(np.array_equal(mine, its) for mine, its in zip(self.elements, elements, strict=False)) and len(
            self.elements
        ) == len(elements)

    def matrix(self, blocks: Floats, bodies: Floats) -> csc_matrix:
        """The matrix (size, size) [mN/mm] of blocks (pairs, 3, 3) and bodies' rows (6 bodies, size)."""
        flat = np.concatenate([blocks.ravel(), bodies.ravel()])
        size = len(self.indptr) - 1
        return csc_matrix((flat[self.source], self.indices, self.indptr), shape=(size, size))


def elements_of(scene: Scene, energy: Energy, coordinates: Coordinates) -> tuple[Ints, ...]:
    """All that the pattern follows from: who joins whom, and which components are unknowns."""
    none = np.zeros(0, np.int64)
    tets, triangles, rings = energy.tets, energy.triangles, energy.bending
    return (
        none if tets is None else scene.tets[tets.tets],
        none if triangles is None else triangles.corners,
        *((none, none, none) if rings is None else (rings.centres, rings.starts, rings.ring)),
        coordinates.index,
        *(body.vertices for body in coordinates.bodies),
    )


def _ring_pairs(rings: Rings) -> tuple[Ints, Ints]:
    """Pairs of vertices of each ring, the centre the first, as of `add_bending_tangent`; and where each ring begins."""
    found = []
    for i, centre in enumerate(rings.centres):
        vertices = np.concatenate([[centre], rings.ring[rings.starts[i] : rings.starts[i + 1]]])
        a, b = np.triu_indices(len(vertices))
        found.append(np.column_stack([vertices[a], vertices[b]]))
    return np.vstack(found), np.concatenate([[0], np.cumsum([len(pairs) for pairs in found])])


def _entries(pairs: Ints, n: int, coordinates: Coordinates) -> tuple[Ints, Ints, Ints]:
    """CSC's indices and indptr, and where each entry comes from."""
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
    """Which unknowns each body is joined to, shape (bodies, size); its own six are."""
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
    return near | _mirrored(near, free)


def _mirrored(near: np.ndarray, free: int) -> np.ndarray:
    """The same for the bodies among one another, the other way round."""
    other = np.zeros_like(near)
    for b in range(len(near)):
        for c in range(len(near)):
            other[b, free + 6 * c : free + 6 * c + 6] = near[c, free + 6 * b]
    return other


def body_rows(
    sparsity: Sparsity, blocks: Floats, coordinates: Coordinates, place: Place, gradient: Floats, *, least: float
) -> Floats:
    """The bodies' rows of the Hessian, shape (6 bodies, size), at a place with this gradient [mN], shape (n, 3).

    What a turn adds by the forces alone is raised to zero where it is negative, unless `least` is.
    """
    n, free, count = len(place.u), len(coordinates.index), len(coordinates.bodies)
    rows = np.zeros((6 * count, coordinates.size))
    if not count:
        return rows
    owner, motion = np.full(n, -1), np.zeros((n, 3, 6))
    for b, body in enumerate(coordinates.bodies):
        owner[body.vertices] = b
        motion[body.vertices, :, :3] = np.eye(3)
        arms = body.arms @ place.rotations[b].T
        motion[body.vertices, :, 3:] = np.cross(np.eye(3), arms[:, None, :]).transpose(0, 2, 1)
    over = np.zeros((6 * count, 3 * n))
    _carry(sparsity.pairs, blocks, owner, motion, over)
    rows[:, :free] = over[:, coordinates.index]
    for b, body in enumerate(coordinates.bodies):
        own = motion[body.vertices].reshape(-1, 6)
        columns = (3 * body.vertices[:, None] + np.arange(3)).ravel()
        block = slice(free + 6 * b, free + 6 * b + 6)
        rows[:, block] = over[:, columns] @ own
        # The second derivative of a turned arm a along the force g: (θ·a)(θ·g) - (a·g) |θ|².
        arms = body.arms @ place.rotations[b].T
        moment = arms.T @ gradient[body.vertices]
        curved = 0.5 * (moment + moment.T) - np.trace(moment) * np.eye(3)
        if least >= 0.0:
            values, vectors = np.linalg.eigh(curved)
            curved = (vectors * np.maximum(values, 0.0)) @ vectors.T
        rows[6 * b + 3 : 6 * b + 6, free + 6 * b + 3 : free + 6 * b + 6] += curved / body.radius
    return rows


@njit(cache=True)
def _carry(pairs, blocks, owner, motion, over):
    """Add motionᵀ K to the rows of the bodies for all blocks that touch one."""
    for k in range(len(pairs)):
        high, low = pairs[k]
        b = owner[high]
        if b >= 0:
            for m in range(6):
                for c in range(3):
                    for r in range(3):
                        over[6 * b + m, 3 * low + c] += motion[high, r, m] * blocks[k, r, c]
        b = owner[low]
        if b >= 0 and high != low:
            for m in range(6):
                for c in range(3):
                    for r in range(3):
                        over[6 * b + m, 3 * high + c] += motion[low, r, m] * blocks[k, c, r]
