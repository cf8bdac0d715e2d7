"""Fewer triangles for a closed surface: edges collapse in the order of the error that this makes."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from numba import njit

from ..errors import InputError
from ..mesh import Floats, Ints, Surface

LENGTH = 1e-3
"""Weight of an edge's squared length against the squared distance to planes: keeps flat parts evenly meshed."""
TURN = 0.3
"""A triangle's normal may turn in one collapse by as much as this cosine allows."""


def simplified(surface: Surface, most: int) -> Surface:
    """A closed manifold surface with at most `most` triangles if collapses that keep it a manifold reach it.

    Garland and Heckbert's quadric error (SIGGRAPH 1997); a collapse must satisfy the link condition (Dey et al. 1999)
    and turn no normal far. Raises InputError unless `most` is at least 4.
    """
    if most < 4:
        raise InputError(f"simplified: most {most} triangles, at least 4 are needed")
    if len(surface.triangles) <= most:
        return surface
    x, triangles = surface.vertices.copy(), surface.triangles.copy()
    alive = _collapse(x, triangles, _quadrics(surface), _edges(triangles), most)
    used, numbers = np.unique(triangles[alive], return_inverse=True)
    return Surface(x[used], numbers.reshape(-1, 3))


def _edges(triangles: Ints) -> Ints:
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0)


def _quadrics(surface: Surface) -> Floats:
    """Per vertex the sum of its triangles' area times squared distance to their plane, as (n, 4, 4)."""
    areas = surface.areas
    normals = surface.face_normals / np.maximum(2 * areas, 1e-30)[:, None]
    offset = -np.einsum("md,md->m", normals, surface.vertices[surface.triangles[:, 0]])
    plane = np.column_stack([normals, offset])
    quadrics = np.zeros((len(surface.vertices), 4, 4))
    faces = areas[:, None, None] * plane[:, :, None] * plane[:, None, :]
    np.add.at(quadrics, surface.triangles.ravel(), np.repeat(faces, 3, axis=0))
    return quadrics


@njit(cache=True)
def _error(quadric, p):
    total = quadric[3, 3]
    for i in range(3):
        total += 2 * quadric[i, 3] * p[i]
        for j in range(3):
            total += quadric[i, j] * p[i] * p[j]
    return total


@njit(cache=True)
def _best(x, quadrics, u, v):
    """Cost of collapsing the edge uv, and how far from u to v the new vertex lies."""
    quadric = quadrics[u] + quadrics[v]
    least, place, squared = np.inf, 0.0, ((x[u] - x[v]) ** 2).sum()
    for share in (0.5, 0.0, 1.0):
        error = _error(quadric, (1 - share) * x[u] + share * x[v])
        if error < least:
            least, place = error, share
    return least + LENGTH * squared * squared, place


@njit(cache=True)
def _ring(u, triangles, alive, head, following, mark, stamp, out):
    """The neighbours of u, each once; returns how many."""
    count, corner = 0, head[u]
    mark[u] = stamp
    while corner >= 0:
        t = corner // 3
        if alive[t]:
            for c in range(3):
                w = triangles[t, c]
                if mark[w] != stamp:
                    mark[w], out[count] = stamp, w
                    count += 1
        corner = following[corner]
    return count


@njit(cache=True)
def _turns(u, other, p, x, triangles, alive, head, following):
    """Whether moving u to p turns a triangle that does not vanish with the edge to `other`."""
    corner = head[u]
    while corner >= 0:
        t, c = corner // 3, corner % 3
        corner = following[corner]
        if not alive[t]:
            continue
        a, b = triangles[t, (c + 1) % 3], triangles[t, (c + 2) % 3]
        if a == other or b == other:
            continue
        before, after = np.cross(x[a] - x[u], x[b] - x[u]), np.cross(x[a] - p, x[b] - p)
        size = np.sqrt((before**2).sum() * (after**2).sum())
        if (before * after).sum() <= TURN * size:
            return True
    return False


@njit(cache=True)
def _collapse(x, triangles, quadrics, edges, most):
    n, m = len(x), len(triangles)
    alive = np.ones(m, np.bool_)
    head, tail, following = np.full(n, -1), np.full(n, -1), np.full(3 * m, -1)
    for corner in range(3 * m):
        v = triangles[corner // 3, corner % 3]
        if head[v] < 0:
            head[v] = corner
        else:
            following[tail[v]] = corner
        tail[v] = corner
    version, mark, stamp = np.zeros(n, np.int64), np.full(n, -1), 0
    of_u, of_v = np.empty(n, np.int64), np.empty(n, np.int64)
    heap = [(_best(x, quadrics, e[0], e[1])[0], e[0], e[1], 0) for e in edges]
    heapify(heap)
    left = m
    while left > most and len(heap) > 0:
        _, u, v, age = heappop(heap)
        if version[u] < 0 or version[v] < 0 or version[u] + version[v] != age:
            continue
        count_u = _ring(u, triangles, alive, head, following, mark, stamp, of_u)
        common = 0
        count_v = _ring(v, triangles, alive, head, following, mark, stamp + 1, of_v)
        for k in range(count_u):
            common += mark[of_u[k]] == stamp + 1 and of_u[k] != v
        stamp += 2
        if common != 2 or count_u + count_v <= 7:
            continue
        share = _best(x, quadrics, u, v)[1]
        p = (1 - share) * x[u] + share * x[v]
        if _turns(u, v, p, x, triangles, alive, head, following) or _turns(
            v, u, p, x, triangles, alive, head, following
        ):
            continue
        corner = head[v]
        while corner >= 0:
            t = corner // 3
            if alive[t]:
                if triangles[t, 0] == u or triangles[t, 1] == u or triangles[t, 2] == u:
                    alive[t] = False
                    left -= 1
                else:
                    triangles[t, corner % 3] = u
            corner = following[corner]
        following[tail[u]], tail[u] = head[v], tail[v]
        x[u] = p
        quadrics[u] += quadrics[v]
        version[v] = -1
        version[u] += 1
        count_u = _ring(u, triangles, alive, head, following, mark, stamp, of_u)
        stamp += 1
        for k in range(count_u):
            w = of_u[k]
            heappush(heap, (_best(x, quadrics, u, w)[0], u, w, version[u] + version[w]))
    return alive
