"""Two triangles that cross: which edges go through which, and the shortest shift that parts them. Compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..mesh import Floats, Ints
from .triangles import segment_hits


@njit(cache=True)
def _extent(corners, n0, n1, n2):
    low, high = np.inf, -np.inf
    for i in range(3):
        s = corners[i, 0] * n0 + corners[i, 1] * n1 + corners[i, 2] * n2
        low, high = min(low, s), max(high, s)
    return low, high


@njit(cache=True)
def _overlap(a, b, n0, n1, n2):
    """The shift along an axis that parts two triangles; infinite for an axis of (nearly) no length."""
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    if length < 1e-12:
        return np.inf
    (low_a, high_a), (low_b, high_b) = _extent(a, n0, n1, n2), _extent(b, n0, n1, n2)
    return min(high_a - low_b, high_b - low_a) / length


@njit(cache=True)
def _cross(u, v):
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@njit(cache=True)
def _parting(first, second):
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


@njit(cache=True)
def _crossed_edges(first, second):
    found = []
    for k in range(len(first)):
        a, b = first[k], second[k]
        for i in range(3):
            if not segment_hits(a, i, (i + 1) % 3, b):
                continue
            for j in range(3):
                if segment_hits(b, j, (j + 1) % 3, a):
                    found.append((k, i, j))
    return found


def parting_shifts(first: Floats, second: Floats) -> Floats:
    """The length [mm] of the shortest shift that parts two triangles, for pairs of corners (k, 3, 3); 0 if apart.

    The least overlap over both normals and the nine cross products of edges: separating axes, as in Gottschalk, Lin and
    Manocha 1996.
    """
    return _parting(np.ascontiguousarray(first), np.ascontiguousarray(second))


def crossed_edges(first: Floats, second: Floats) -> Ints:
    """Triples (pair, i, j), shape (r, 3): edge i of the first triangle meets the second, and j of it the first.

    For pairs of corners (k, 3, 3); edge i goes from corner i to the next.
    """
    found = _crossed_edges(np.ascontiguousarray(first), np.ascontiguousarray(second))
    return np.array(found, dtype=np.int64).reshape(-1, 3)
