"""Elements split at the middles of their edges."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints


def midpoints(elements: Ints, edges: Ints, n: int) -> tuple[Ints, Ints]:
    """The distinct edges (e, 2) of elements (m, corners) over n vertices, and the number of each element's, (m, k).

    edges (k, 2) names the corners that an edge joins.
    """
    ends = np.sort(elements[:, edges].reshape(-1, 2), axis=1)
    distinct, where = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    return np.stack([distinct // n, distinct % n], axis=1), where.reshape(len(elements), len(edges))


def split_triangles(triangles: Ints, n: int) -> tuple[Ints, Ints]:
    """Every triangle over n vertices split into four, shape (4 m, 3), and the edges (e, 2) in whose middles they meet.

    The middle of edge k is vertex n + k.
    """
    ends, middles = midpoints(triangles, np.array([[0, 1], [1, 2], [2, 0]]), n)
    a, b, c = triangles.T
    ab, bc, ca = n + middles.T
    parts = [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return np.stack(parts, axis=1).reshape(-1, 3), ends


def subdivide(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Vertices and triangles with every triangle split into four at its edges' midpoints, which come after them."""
    finer, ends = split_triangles(triangles, len(vertices))
    return np.vstack([vertices, vertices[ends].mean(axis=1)]), finer
