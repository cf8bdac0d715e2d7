"""Connectivity of a mesh: edges, openings and connected parts; elements split at the middles of their edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components

from ..errors import MeshError
from ..mesh import Floats, Ints, Surface


def directed_edges(triangles: Ints) -> Ints:
    """Return the edges of triangles (m, 3), shape (3 m, 2): edge k of a triangle runs from corner k to k + 1."""
    return triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


SIDES = np.array([[0, 1], [1, 2], [2, 0]])
"""Corners of a triangle's edges."""


def number_edges(triangles: Ints) -> tuple[Ints, Ints, Ints]:
    """Return each edge of triangles (m, 3) once, the edges of each by number, and how many triangles have each.

    Edges (e, 2) have their smaller vertex first and rise; numbers (m, 3) are as in `directed_edges`; counts (e,).
    """
    edges, number = midpoints(triangles, SIDES, int(triangles.max(initial=-1)) + 1)
    return edges, number, np.bincount(number.ravel(), minlength=len(edges))


def unique_edges(triangles: Ints) -> Ints:
    """Return each edge of triangles (m, 3) once, its smaller vertex first, in rising order, shape (e, 2)."""
    return number_edges(triangles)[0]


def open_edges(triangles: Ints) -> Ints:
    """Return the edges that have one triangle, shape (k, 2)."""
    edges, _, count = number_edges(triangles)
    return edges[count == 1]


def _edge_keys(triangles: Ints) -> tuple[Ints, Ints]:
    """Return one number for each directed edge, and that of the edge run back, shape (3 m,)."""
    a, b = directed_edges(triangles).T
    n = int(triangles.max()) + 1
    return a * n + b, b * n + a


def is_closed(triangles: Ints) -> bool:
    """Return whether each edge is run through once in either direction: a closed, consistently oriented surface."""
    forth, back = (np.sort(keys) for keys in _edge_keys(triangles))
    return bool((np.diff(forth) > 0).all() and np.array_equal(forth, back))


def across_edges(triangles: Ints) -> Ints:
    """Return the triangle across edge k (corner k to k + 1) of each triangle of a closed surface, shape (m, 3)."""
    forth, back = _edge_keys(triangles)
    order = np.argsort(forth)
    return order[np.searchsorted(forth[order], back)].reshape(-1, 3) // 3


def close_openings(surface: Surface) -> Surface:
    """Close a surface's openings by fans; its own vertices come first, one more for each opening follows.

    Raises MeshError for edges with more than two triangles, and for neighbours oriented against one another.
    """
    loops = find_openings(surface.triangles)
    if not loops:
        return surface
    first = len(surface.vertices)
    centres = np.array([surface.vertices[loop].mean(axis=0) for loop in loops])
    fans = [np.stack([np.roll(loop, -1), loop, np.full(len(loop), first + k)], axis=1) for k, loop in enumerate(loops)]
    return Surface(np.vstack([surface.vertices, centres]), np.vstack([surface.triangles, *fans]))


def find_openings(triangles: Ints) -> list[Ints]:
    """Find the loops of edges that have one triangle, as vertices in their triangles' direction, the longest first.

    Where the boundary touches itself at a vertex it is several loops. Raises MeshError for edges with more than two
    triangles, and for neighbours oriented against one another.
    """
    forth, back = _edge_keys(triangles)
    if len(np.unique(forth)) < len(forth):
        raise MeshError("skin: edges with more than two triangles, or neighbours oriented against one another")
    following: dict[int, list[int]] = {}
    for start, end in directed_edges(triangles)[~np.isin(forth, back)].tolist():
        following.setdefault(start, []).append(end)
    loops = []
    while following:
        way = [next(iter(following))]
        place = {way[0]: 0}
        # Each vertex has as many edges out as in, so the way ends only where it began.
        while way[-1] in following:
            ends = following[way[-1]]
            end = ends.pop()
            if not ends:
                del following[way[-1]]
            if end in place:
                loops.append(np.array(way[place[end] :]))
                for vertex in way[place[end] + 1 :]:
                    del place[vertex]
                way = way[: place[end] + 1]
            else:
                place[end] = len(way)
                way.append(end)
    return sorted(loops, key=len, reverse=True)


def keep_triangles(surface: Surface, kept: NDArray[np.bool_]) -> Surface:
    """Keep the triangles of a mask (m,), over their own vertices."""
    used, numbers = np.unique(surface.triangles[kept], return_inverse=True)
    return Surface(surface.vertices[used], numbers.reshape(-1, 3))


def join_surfaces(surfaces: Sequence[Surface]) -> Surface:
    """Return surfaces as one, their vertices and triangles one after another."""
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    triangles = [surface.triangles + start for surface, start in zip(surfaces, starts[:-1], strict=True)]
    return Surface(np.vstack([surface.vertices for surface in surfaces]), np.vstack(triangles))


def connected_parts(triangles: NDArray[np.integer], n_vertices: int) -> tuple[int, Ints]:
    """Return how many parts hang together through triangles, and the part of each vertex, shape (n,)."""
    pairs = (np.repeat(triangles[:, 0], 2), triangles[:, 1:].ravel())
    graph = coo_matrix((np.ones(len(pairs[0])), pairs), shape=(n_vertices, n_vertices))
    return connected_components(graph, directed=False)


def midpoints(elements: Ints, edges: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the distinct edges (e, 2) of elements (m, corners) over n vertices, and each element's by number, (m, k).

    edges (k, 2) names the corners that an edge joins.
    """
    ends = np.sort(elements[:, edges].reshape(-1, 2), axis=1)
    distinct, where = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    return np.stack([distinct // n, distinct % n], axis=1), where.reshape(len(elements), len(edges))


def split_triangles(triangles: Ints, n: int) -> tuple[Ints, Ints]:
    """Split every triangle over n vertices into four, shape (4 m, 3); also the edges (e, 2) in whose middles they meet.

    The middle of edge k is vertex n + k.
    """
    ends, middles = midpoints(triangles, SIDES, n)
    a, b, c = triangles.T
    ab, bc, ca = n + middles.T
    parts = [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return np.stack(parts, axis=1).reshape(-1, 3), ends


def subdivide(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Split every triangle into four at its edges' midpoints, which come after the vertices."""
    finer, ends = split_triangles(triangles, len(vertices))
    return np.vstack([vertices, vertices[ends].mean(axis=1)]), finer


def pick_rows(ids: Ints, n: int) -> csr_matrix:
    """Return the matrix (k, n) that takes the rows `ids` (k,) of what it is applied to."""
    return csr_matrix((np.ones(len(ids)), (np.arange(len(ids)), ids)), shape=(len(ids), n))


def neighbours(triangles: Ints, n: int) -> csr_matrix:
    """Return the edges of a closed surface as a symmetric matrix of ones, shape (n, n)."""
    i, j, k = triangles.T
    rows, columns = np.concatenate([i, j, k]), np.concatenate([j, k, i])
    matrix = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    return ((matrix + matrix.T) > 0).astype(np.float64).tocsr()


def graph_laplacian(edges: csr_matrix) -> csr_matrix:
    """Return D - W of symmetric weights W (n, n), as those of `neighbours`; D has their sums on its diagonal."""
    return (diags(np.asarray(edges.sum(axis=1)).ravel()) - edges).tocsr()
