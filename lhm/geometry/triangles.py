"""Two triangles, or a point and a triangle, in space: compiled geometric tests."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def closest_on_triangle(p, corners):
    """Barycentric weights (3,) of the point of a triangle (3, 3) closest to p, and the squared distance.

    Voronoi regions of corners, edges and face (Ericson, Real-Time Collision Detection, section 5.1.5).
    """
    a, b, c = corners[0], corners[1], corners[2]
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    bp, cp = p - b, p - c
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    w = np.zeros(3)
    if d1 <= 0 and d2 <= 0:
        w[0] = 1.0
    elif d3 >= 0 and d4 <= d3:
        w[1] = 1.0
    elif d6 >= 0 and d5 <= d6:
        w[2] = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        w[1] = d1 / (d1 - d3)
        w[0] = 1 - w[1]
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        w[2] = d2 / (d2 - d6)
        w[0] = 1 - w[2]
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        w[2] = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        w[1] = 1 - w[2]
    else:
        total = va + vb + vc
        w[0], w[1], w[2] = va / total, vb / total, vc / total
    gap = p - (w[0] * a + w[1] * b + w[2] * c)
    return w, _dot(gap, gap)


@njit(cache=True)
def _segment_hits(p, q, corners):
    """Whether the segment pq meets the triangle, touching included; a segment in its plane does not count."""
    e1, e2, d = corners[1] - corners[0], corners[2] - corners[0], q - p
    h = np.cross(d, e2)
    det = _dot(e1, h)
    if abs(det) < 1e-14 * np.sqrt(_dot(e1, e1) * _dot(e2, e2) * _dot(d, d)):
        return False
    s = p - corners[0]
    u = _dot(s, h) / det
    if u < 0 or u > 1:
        return False
    k = np.cross(s, e1)
    v = _dot(d, k) / det
    if v < 0 or u + v > 1:
        return False
    t = _dot(e2, k) / det
    return 0 <= t <= 1


@njit(cache=True)
def triangles_cross(a, b):
    """Whether two triangles (3, 3) have a point in common, but for triangles in one plane.

    Two triangles that are not coplanar meet exactly if an edge of one meets the other (Moeller and Trumbore's test).
    """
    for i in range(3):
        j = (i + 1) % 3
        if _segment_hits(a[i], a[j], b) or _segment_hits(b[i], b[j], a):
            return True
    return False
