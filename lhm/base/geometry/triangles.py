"""Two triangles, or a point and a triangle, in space: compiled geometric tests.

Written in scalars: a small array made in the innermost loop costs more than the arithmetic.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ..kernels import njit
from ..mesh import Floats, Ints


@njit(cache=True, inline="always")
def _dot(a0, a1, a2, b0, b1, b2):
    return a0 * b0 + a1 * b1 + a2 * b2


@njit(cache=True)
def closest_on_triangle(p, corners):
    """Return barycentric weights (three floats) of a triangle's point (3, 3) closest to p, and the squared distance.

    Voronoi regions of corners, edges and face (Ericson, Real-Time Collision Detection, section 5.1.5). A triangle
    without area is the edges and corners that it has.
    """
    a0, a1, a2 = corners[0, 0], corners[0, 1], corners[0, 2]
    b0, b1, b2 = corners[1, 0] - a0, corners[1, 1] - a1, corners[1, 2] - a2
    c0, c1, c2 = corners[2, 0] - a0, corners[2, 1] - a1, corners[2, 2] - a2
    p0, p1, p2 = p[0] - a0, p[1] - a1, p[2] - a2
    bb, cc, bc = _dot(b0, b1, b2, b0, b1, b2), _dot(c0, c1, c2, c0, c1, c2), _dot(b0, b1, b2, c0, c1, c2)
    d1, d2 = _dot(b0, b1, b2, p0, p1, p2), _dot(c0, c1, c2, p0, p1, p2)
    d3, d4, d5, d6 = d1 - bb, d2 - bc, d1 - bc, d2 - cc
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    u, v, w = 0.0, 0.0, 0.0
    if d1 <= 0 and d2 <= 0:
        u = 1.0
    elif d3 >= 0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0 and d5 <= d6:
        w = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0 and d1 > d3:
        v = d1 / (d1 - d3)
        u = 1 - v
    elif vb <= 0 and d2 >= 0 and d6 <= 0 and d2 > d6:
        w = d2 / (d2 - d6)
        u = 1 - w
    elif va <= 0 and d4 >= d3 and d5 >= d6 and (d4 - d3) + (d5 - d6) > 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1 - w
    elif va + vb + vc > 0:
        total = va + vb + vc
        u, v, w = va / total, vb / total, vc / total
    else:
        u = 1.0
    g0, g1, g2 = p0 - v * b0 - w * c0, p1 - v * b1 - w * c1, p2 - v * b2 - w * c2
    return u, v, w, _dot(g0, g1, g2, g0, g1, g2)


@njit(cache=True)
def segment_hits(segment, i, j, corners):
    """Return whether the segment between rows i and j meets the triangle, touching included.

    A segment in the triangle's plane does not count (Möller and Trumbore's test), nor a triangle without area.
    """
    a0, a1, a2 = corners[0, 0], corners[0, 1], corners[0, 2]
    b0, b1, b2 = corners[1, 0] - a0, corners[1, 1] - a1, corners[1, 2] - a2
    c0, c1, c2 = corners[2, 0] - a0, corners[2, 1] - a1, corners[2, 2] - a2
    p0, p1, p2 = segment[i, 0], segment[i, 1], segment[i, 2]
    d0, d1, d2 = segment[j, 0] - p0, segment[j, 1] - p1, segment[j, 2] - p2
    h0, h1, h2 = d1 * c2 - d2 * c1, d2 * c0 - d0 * c2, d0 * c1 - d1 * c0
    det = _dot(b0, b1, b2, h0, h1, h2)
    scale = _dot(b0, b1, b2, b0, b1, b2) * _dot(c0, c1, c2, c0, c1, c2) * _dot(d0, d1, d2, d0, d1, d2)
    if not det * det > 1e-28 * scale:
        return False
    s0, s1, s2 = p0 - a0, p1 - a1, p2 - a2
    u = _dot(s0, s1, s2, h0, h1, h2) / det
    if u < 0 or u > 1:
        return False
    k0, k1, k2 = s1 * b2 - s2 * b1, s2 * b0 - s0 * b2, s0 * b1 - s1 * b0
    v = _dot(d0, d1, d2, k0, k1, k2) / det
    if v < 0 or u + v > 1:
        return False
    t = _dot(c0, c1, c2, k0, k1, k2) / det
    return 0 <= t <= 1


@njit(cache=True)
def _on_one_side(a, b):
    """Return whether triangle b lies strictly on one side of the plane of triangle a, by more than rounding."""
    u0, u1, u2 = a[1, 0] - a[0, 0], a[1, 1] - a[0, 1], a[1, 2] - a[0, 2]
    v0, v1, v2 = a[2, 0] - a[0, 0], a[2, 1] - a[0, 1], a[2, 2] - a[0, 2]
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    low, high, size = np.inf, -np.inf, 0.0
    for k in range(3):
        w0, w1, w2 = b[k, 0] - a[0, 0], b[k, 1] - a[0, 1], b[k, 2] - a[0, 2]
        height = _dot(n0, n1, n2, w0, w1, w2)
        low, high = min(low, height), max(high, height)
        size = max(size, abs(n0 * w0) + abs(n1 * w1) + abs(n2 * w2))
    return low > 1e-14 * size or high < -1e-14 * size


@njit(cache=True)
def triangles_cross(a, b):
    """Return whether two triangles (3, 3) have a point in common, but for triangles in one plane.

    Two triangles that are not coplanar meet exactly if an edge of one meets the other.
    """
    if _on_one_side(a, b) or _on_one_side(b, a):
        return False
    for i in range(3):
        j = (i + 1) % 3
        if segment_hits(a, i, j, b) or segment_hits(b, i, j, a):
            return True
    return False


@njit(cache=True)
def _extent(corners, n0, n1, n2):
    low, high = np.inf, -np.inf
    for i in range(3):
        s = corners[i, 0] * n0 + corners[i, 1] * n1 + corners[i, 2] * n2
        low, high = min(low, s), max(high, s)
    return low, high


@njit(cache=True)
def _overlap(a, b, n0, n1, n2):
    """Return the shift along an axis that parts two triangles; infinite for an axis of (nearly) no length."""
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    if length < 1e-12:
        return np.inf
    (low_a, high_a), (low_b, high_b) = _extent(a, n0, n1, n2), _extent(b, n0, n1, n2)
    return min(high_a - low_b, high_b - low_a) / length


@njit(cache=True)
def _cross(u, v):
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@njit(cache=True)
def _find_parting(first, second):
    shifts = np.empty(len(first))
    for k in range(len(first)):
        a, b = first[k], second[k]
        shift = _overlap(a, b, *_cross(a[1] - a[0], a[2] - a[0]))
        shift = min(shift, _overlap(a, b, *_cross(b[1] - b[0], b[2] - b[0])))
        for i in range(3):
            for j in range(3):
                shift = min(shift, _overlap(a, b, *_cross(a[(i + 1) % 3] - a[i], b[(j + 1) % 3] - b[j])))
        shifts[k] = max(shift, 0.0)
    return shifts


def parting_shifts(first: Floats, second: Floats) -> Floats:
    """Return the length [mm] of the shortest shift that parts two triangles, for pairs of corners (k, 3, 3).

    It is 0 for triangles apart. The least overlap over both normals and the nine cross products of edges: separating
    axes, as in Gottschalk, Lin and Manocha 1996.
    """
    return _find_parting(np.ascontiguousarray(first), np.ascontiguousarray(second))


def fan_crossings(vertices: Floats, triangles: Ints) -> Ints:
    """Return pairs of triangles with exactly one common vertex that have more in common than it, shape (k, 2).

    Two such triangles cross exactly if the side of one that lies opposite the vertex meets the other.
    """
    corners = np.argsort(triangles.ravel(), kind="stable")
    first = np.searchsorted(triangles.ravel()[corners], np.arange(len(vertices) + 1))
    crossings = _fan_crossings(np.ascontiguousarray(vertices), np.ascontiguousarray(triangles), corners, first)
    return np.array(crossings, dtype=np.int64).reshape(-1, 2)


@njit(cache=True)
def _fan_crossings(vertices, triangles, corners, first):
    crossings = []
    for v in range(len(first) - 1):
        for a in range(first[v], first[v + 1]):
            s, i = corners[a] // 3, corners[a] % 3
            for b in range(first[v], a):
                t, j = corners[b] // 3, corners[b] % 3
                common = 0
                for m in range(3):
                    for n in range(3):
                        common += triangles[s, m] == triangles[t, n]
                if common != 1:
                    continue
                x, y = vertices[triangles[s]], vertices[triangles[t]]
                if segment_hits(x, (i + 1) % 3, (i + 2) % 3, y) or segment_hits(y, (j + 1) % 3, (j + 2) % 3, x):
                    crossings.append((t, s))
    return crossings


def barycentric_matrix(ids: Ints, weights: Floats, shape: tuple[int, int]) -> csr_matrix:
    """Make a matrix of this shape whose k rows have the weights (k, 3) of the vertices `ids` (k, 3)."""
    return csr_matrix((weights.ravel(), (np.repeat(np.arange(len(ids)), 3), ids.ravel())), shape=shape)
