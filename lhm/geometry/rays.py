"""Where rays first meet the triangles of a tree, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..mesh import Floats, Ints
from .bvh import TriangleTree

EDGE = 1e-9
"""Share of a triangle by which a ray may pass beyond its edge, so that none slips between two neighbours."""


@njit(cache=True)
def _enters(box, origin, direction, most):
    """The parameter at which a ray enters a box, or infinity if it does not before `most`."""
    low, high = 0.0, most
    for c in range(3):
        if direction[c] == 0.0:
            if origin[c] < box[c] or origin[c] > box[3 + c]:
                return np.inf
            continue
        a, b = (box[c] - origin[c]) / direction[c], (box[3 + c] - origin[c]) / direction[c]
        low, high = max(low, min(a, b)), min(high, max(a, b))
    return low if low <= high else np.inf


@njit(cache=True)
def _meets(origin, direction, corners):
    """The parameter at which a ray meets a triangle (3, 3), or infinity (Moeller and Trumbore 1997)."""
    e1, e2 = corners[1] - corners[0], corners[2] - corners[0]
    h = np.cross(direction, e2)
    det = np.dot(e1, h)
    if det == 0.0:
        return np.inf
    s = origin - corners[0]
    u = np.dot(s, h) / det
    k = np.cross(s, e1)
    v = np.dot(direction, k) / det
    t = np.dot(e2, k) / det
    return t if u >= -EDGE and v >= -EDGE and u + v <= 1 + EDGE and t >= 0.0 else np.inf


@njit(cache=True)
def _first(origins, directions, reach, corners, order, start, stop, left, box):
    n = len(origins)
    which, distance = np.full(n, -1), np.full(n, np.inf)
    stack = np.empty(128, np.int64)
    for i in range(n):
        origin, direction, best = origins[i], directions[i], reach
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            node = stack[size]
            if _enters(box[node], origin, direction, best) == np.inf:
                continue
            if left[node] >= 0:
                stack[size], stack[size + 1] = left[node], left[node] + 1
                size += 2
                continue
            for k in range(start[node], stop[node]):
                t = _meets(origin, direction, corners[order[k]])
                if t <= best:
                    best, which[i], distance[i] = t, order[k], t
    return which, distance


def first_hits(tree: TriangleTree, origins: Floats, directions: Floats, reach: float) -> tuple[Ints, Floats]:
    """Triangle (k,) that each ray meets first, from either side, and the way there (k,) in lengths of `directions`.

    Triangle -1 and an infinite way for a ray that meets none within `reach`.
    """
    rays = (np.ascontiguousarray(values, dtype=np.float64) for values in (origins, directions))
    return _first(*rays, float(reach), tree.corners, *tree._nodes)
