"""A head's skin out of a larger model: cut off, closed, and lips that keep their distance."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..base.errors import MeshError
from ..base.geometry.topology import find_openings, pick_rows
from ..base.mesh import Floats, Ints
from .space import MOUTH, OUTSIDE

RINGS = 5
EVEN = 6
REACH = 6.0
WIDTH = 5.0


def close_loop(loop: Ints, n_vertices: int) -> tuple[csr_matrix, Ints]:
    """Close a loop by rings that shrink to its centroid: weights of the new vertices, and triangles.

    The new vertices are numbered from `n_vertices` on; weights have shape (new vertices, n_vertices).
    """
    k = len(loop)
    outermost = pick_rows(loop, n_vertices)
    centre = csr_matrix((np.full(k, 1.0 / k), (np.zeros(k, int), loop)), shape=(1, n_vertices))
    every = vstack([centre] * k)
    new = [(1 - r / RINGS) * outermost + (r / RINGS) * every for r in range(1, RINGS)]
    ids = [loop] + [n_vertices + k * r + np.arange(k) for r in range(RINGS - 1)]
    triangles = []
    for outer, inner in zip(ids, ids[1:], strict=False):
        a, b, c, d = outer, np.roll(outer, -1), inner, np.roll(inner, -1)
        triangles += [np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)]
    last, tip = ids[-1], n_vertices + k * (RINGS - 1)
    triangles.append(np.stack([np.roll(last, -1), last, np.full(k, tip)], axis=1))
    return vstack([*new, centre]).tocsr(), np.vstack(triangles)


def even_loop(loop: Ints, n_vertices: int) -> csr_matrix:
    """Smooth the saw teeth of a loop that follows the edges of a mesh: weights (n, n); the rest stays."""
    weights = identity(n_vertices, format="lil")
    for before, vertex, after in zip(np.roll(loop, 1), loop, np.roll(loop, -1), strict=True):
        weights[vertex, [before, vertex, after]] = (0.25, 0.5, 0.25)
    once = weights.tocsr()
    return once**EVEN


def largest_piece(triangles: Ints) -> Ints:
    """Keep the triangles of the largest piece connected through vertices."""
    n = int(triangles.max()) + 1
    pairs = triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    _, label = connected_components(csr_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n)), directed=False)
    kept = label[triangles[:, 0]]
    return triangles[kept == np.bincount(kept).argmax()]


def cut_and_close(triangles: Ints, n_vertices: int) -> tuple[csr_matrix, Ints, Ints]:
    """Drop unused vertices and close the one open boundary.

    Returns weights (new vertices, n_vertices), triangles of the new vertices, and the old indices of the vertices
    kept, which come first and in their order; the lid's follow.
    Raises MeshError unless there is exactly one boundary loop.
    """
    used, number = np.unique(triangles, return_inverse=True)
    triangles = number.reshape(-1, 3)
    loops = find_openings(triangles)
    if len(loops) != 1:
        raise MeshError(f"expected one open boundary at the neck, found {len(loops)}")
    lid, more = close_loop(loops[0], len(used))
    kept = even_loop(loops[0], len(used)) @ pick_rows(used, n_vertices)
    return vstack([kept, lid @ kept]).tocsr(), np.vstack([triangles, more]), used


def keep_lips_together(mean: Floats, triangles: Ints, parts: Ints, directions: Floats) -> Floats:
    """Average the directions (k, n, 3) [mm] near the lips' rim over both lips alike.

    A linear model of neutral heads knows no contact: the lips of `mean` (n, 3) [mm] are half a millimetre apart, and
    a direction that thickens or squeezes them lets them cross. Within some 6 mm of the rim a direction is replaced by
    its mean over 5 mm, so that facing points of the two lips move together; farther away it stays as it is.
    """
    mixed = triangles[(parts[triangles] == MOUTH).any(axis=1)]
    rim = np.unique(mixed[parts[mixed] == OUTSIDE])
    share = np.exp(-((cKDTree(mean[rim]).query(mean)[0] / REACH) ** 2))
    near = np.flatnonzero(share > 0.01)
    tree = cKDTree(mean)
    table = cKDTree(mean[near]).sparse_distance_matrix(tree, 2.5 * WIDTH, output_type="ndarray")
    shape = (len(near), len(mean))
    weights = csr_matrix((np.exp(-((table["v"] / WIDTH) ** 2)), (table["i"], table["j"])), shape=shape)
    total = np.asarray(weights.sum(axis=1)).ravel()
    moved = directions.copy()
    for direction in moved:
        average = (weights @ direction) / total[:, None]
        direction[near] += share[near, None] * (average - direction[near])
    return moved
