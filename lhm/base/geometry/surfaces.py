"""Closed surfaces: the geodesic sphere, the zero surface of a field (surface nets), and simplification."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
import trimesh
from numba import njit

from ..errors import InputError
from ..mesh import Floats, Ints, Surface
from .topology import unique_edges


def geodesic_sphere(frequency: int) -> tuple[Floats, Ints]:
    """Return the unit icosphere whose edges are cut into `frequency` parts: 10 f² + 2 vertices, 20 f² triangles.

    It is its own mirror image at x = 0. Vertices rise in y, then in z, so that twins follow one another, and a vertex
    has a smaller number than its neighbour where its twin has.
    """
    base = trimesh.creation.icosahedron()
    rows = [(i, j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    place = {ij: k for k, ij in enumerate(rows)}
    weights = np.array([(frequency - i - j, i, j) for i, j in rows]) / frequency
    local = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i, j in rows if i + j < frequency]
    local += [(place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]) for i, j in rows if i + j < frequency - 1]
    points = np.einsum("kc,fcd->fkd", weights, np.asarray(base.vertices)[base.faces]).reshape(-1, 3)
    triangles = (np.array(local)[None] + len(rows) * np.arange(len(base.faces))[:, None, None]).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    _, first, number = np.unique(np.round(points[:, [1, 2, 0]], 9), axis=0, return_index=True, return_inverse=True)
    return points[first], number.ravel()[triangles]


_AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def zero_surface(field: Floats, origin: Floats, spacing: float) -> Surface:
    """Return the closed surface around where `field` (i, j, k) is negative, normals outward; empty if it nowhere is.

    Point (a, b, c) of the grid lies at origin + spacing (a, b, c) [mm]. Every cell with both signs gets one vertex, the
    mean of its edges' zeros; every edge with both signs gets a quad of its four cells (surface nets, Gibson 1998).
    Where cells would touch at an edge or corner only, points change to negative, so the result is a 2-manifold.
    """
    values = np.pad(field, 1, constant_values=np.inf)
    inside = _well_composed(values < 0)
    # What changed sign lies just inside; what is infinite, or far from zero, far outside.
    depth = np.where(inside, np.minimum(values, -1e-3 * spacing), np.maximum(values, 1e-3 * spacing))
    depth = np.clip(depth, -4 * spacing, 4 * spacing)
    total, count = np.zeros((*np.subtract(inside.shape, 1), 3)), np.zeros(np.subtract(inside.shape, 1))
    for axis, u, v in _AXES:
        start = np.argwhere(_mixed_edges(inside, axis)[0])
        step = np.eye(3, dtype=np.int64)[axis]
        a, b = depth[tuple(start.T)], depth[tuple((start + step).T)]
        zero = start + (a / (a - b))[:, None] * step
        for cell in _around(start, u, v):
            np.add.at(total, tuple(cell.T), zero)
            np.add.at(count, tuple(cell.T), 1.0)
    used = count > 0
    number = np.cumsum(used.ravel()).reshape(used.shape) - 1
    vertices = origin + spacing * (total[used] / count[used][:, None] - 1.0)
    quads = []
    for axis, u, v in _AXES:
        mixed, outward = _mixed_edges(inside, axis)
        start = np.argwhere(mixed)
        ring = np.stack([number[tuple(cell.T)] for cell in _around(start, u, v)], axis=1)
        quads.append(np.where(outward[tuple(start.T)][:, None], ring, ring[:, ::-1]))
    ring = np.vstack(quads)
    return Surface(vertices, _split(vertices, ring))


def _mixed_edges(inside, axis: int):
    """Return masks over the edges along an axis: both signs, and negative at the start."""
    start = np.take(inside, range(inside.shape[axis] - 1), axis)
    end = np.take(inside, range(1, inside.shape[axis]), axis)
    return start != end, start


def _around(start: Ints, u: int, v: int) -> list[Ints]:
    """Return the four cells around edges, counter-clockwise as seen from the edge's end."""
    eu, ev = np.eye(3, dtype=np.int64)[[u, v]]
    return [start - eu - ev, start - ev, start, start - eu]


def _split(x: Floats, quads: Ints) -> Ints:
    """Return two triangles per quad, along its shorter diagonal."""
    a, b, c, d = quads.T
    first = np.linalg.norm(x[a] - x[c], axis=1) <= np.linalg.norm(x[b] - x[d], axis=1)
    upper = np.where(first[:, None], np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    lower = np.where(first[:, None], np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.vstack([upper, lower])


def _well_composed(inside):
    """Add points until none of them meet at an edge or corner only: the surface between is then a manifold.

    Latecki, 3D well-composed pictures, Graph. Models Image Process. 59 (1997).
    """
    inside = inside.copy()
    while True:
        before = inside.sum()
        for axis in range(3):
            x = np.moveaxis(inside, axis, 0)
            a, b, c, d = x[:, :-1, :-1], x[:, 1:, 1:], x[:, :-1, 1:], x[:, 1:, :-1]
            add = a & b & ~c & ~d
            c |= add
            add = c & d & ~a & ~b
            a |= add
        corners = [
            (
                inside[i : inside.shape[0] - 1 + i, j : inside.shape[1] - 1 + j, k : inside.shape[2] - 1 + k],
                inside[1 - i : inside.shape[0] - i, 1 - j : inside.shape[1] - j, 1 - k : inside.shape[2] - k],
            )
            for i, j, k in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
        ]
        count = sum(a.astype(np.int8) + b for a, b in corners)
        for pair, (a, b) in enumerate(corners):
            touching, bare = (count == 2) & a & b, (count == 6) & ~a & ~b
            a |= bare
            corners[(pair + 1) % 4][0][touching] = True
        if inside.sum() == before:
            return inside


LENGTH = 1e-3
"""Weight of an edge's squared length against the squared distance to planes: keeps flat parts evenly meshed."""
TURN = 0.3
"""A triangle's normal may turn in one collapse by as much as this cosine allows."""


def simplify(surface: Surface, most: int) -> Surface:
    """Collapse edges of a closed manifold to at most `most` triangles, if collapses that keep it a manifold reach it.

    Garland and Heckbert's quadric error (SIGGRAPH 1997); a collapse must satisfy the link condition (Dey et al. 1999)
    and turn no normal far. Raises InputError unless `most` is at least 4.
    """
    if most < 4:
        raise InputError(f"simplify: most {most} triangles, at least 4 are needed")
    if len(surface.triangles) <= most:
        return surface
    x, triangles = surface.vertices.copy(), surface.triangles.copy()
    alive = _collapse(x, triangles, _quadrics(surface), unique_edges(triangles), most)
    used, numbers = np.unique(triangles[alive], return_inverse=True)
    return Surface(x[used], numbers.reshape(-1, 3))


def _quadrics(surface: Surface) -> Floats:
    """Return per vertex the sum of its triangles' area times squared distance to their plane, as (n, 4, 4)."""
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
def _cheapest(x, quadrics, u, v):
    """Return the cost of collapsing the edge uv, and how far from u to v the new vertex lies."""
    quadric = quadrics[u] + quadrics[v]
    least, place, squared = np.inf, 0.0, ((x[u] - x[v]) ** 2).sum()
    for share in (0.5, 0.0, 1.0):
        error = _error(quadric, (1 - share) * x[u] + share * x[v])
        if error < least:
            least, place = error, share
    return least + LENGTH * squared * squared, place


@njit(cache=True)
def _ring(u, triangles, alive, head, following, mark, stamp, out):
    """Write the neighbours of u, each once, to `out`; return how many."""
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
    """Return whether moving u to p turns a triangle that does not vanish with the edge to `other`."""
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
    heap = [(_cheapest(x, quadrics, e[0], e[1])[0], e[0], e[1], 0) for e in edges]
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
        share = _cheapest(x, quadrics, u, v)[1]
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
            heappush(heap, (_cheapest(x, quadrics, u, w)[0], u, w, version[u] + version[w]))
    return alive
