"""A bounding-volume tree over tets: which of them hold a point, compiled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from ..mesh import Floats, Ints
from .bvh import _build, _refit


@njit(cache=True)
def _boxes(corners):
    low, high = np.empty((len(corners), 3)), np.empty((len(corners), 3))
    for t in range(len(corners)):
        for c in range(3):
            w, x, y, z = corners[t, 0, c], corners[t, 1, c], corners[t, 2, c], corners[t, 3, c]
            low[t, c], high[t, c] = min(w, x, y, z), max(w, x, y, z)
    return low, high


@njit(cache=True)
def _volume(a, b, c, d):
    """Six times the signed volume of a tet."""
    b0, b1, b2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    c0, c1, c2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    d0, d1, d2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return d0 * (b1 * c2 - b2 * c1) + d1 * (b2 * c0 - b0 * c2) + d2 * (b0 * c1 - b1 * c0)


@njit(cache=True)
def _containing(points, besides, ids, corners, order, start, stop, left, box):
    """Pairs (point, tet) and barycentric weights, without the tets that have the vertex `besides` of a point."""
    pairs, weights = [], []
    stack = np.empty(128, np.int64)
    for i in range(len(points)):
        p = points[i]
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            node = stack[size]
            b = box[node]
            if p[0] < b[0] or p[1] < b[1] or p[2] < b[2] or p[0] > b[3] or p[1] > b[4] or p[2] > b[5]:
                continue
            if left[node] >= 0:
                stack[size], stack[size + 1] = left[node], left[node] + 1
                size += 2
                continue
            for k in range(start[node], stop[node]):
                t = order[k]
                if (
                    besides[i] == ids[t, 0]
                    or besides[i] == ids[t, 1]
                    or besides[i] == ids[t, 2]
                    or besides[i] == ids[t, 3]
                ):
                    continue
                x = corners[t]
                w0, w1 = _volume(p, x[1], x[2], x[3]), _volume(x[0], p, x[2], x[3])
                w2, w3 = _volume(x[0], x[1], p, x[3]), _volume(x[0], x[1], x[2], p)
                total = _volume(x[0], x[1], x[2], x[3])
                if total > 0 and w0 >= 0 and w1 >= 0 and w2 >= 0 and w3 >= 0:
                    pairs.append((i, t))
                    weights.append((w0 / total, w1 / total, w2 / total, w3 / total))
    return pairs, weights


@dataclass(frozen=True, eq=False)
class TetTree:
    """Which tets (m, 4) of `vertices` (n, 3) [mm] hold a point; tets may overlap, and inverted ones hold nothing."""

    vertices: Floats
    tets: Ints
    layout: tuple[np.ndarray, ...] | None = field(default=None, repr=False)
    corners: Floats = field(init=False, repr=False)
    _nodes: tuple[np.ndarray, ...] = field(init=False, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "corners", np.ascontiguousarray(self.vertices[self.tets]))
        low, high = _boxes(self.corners)
        nodes = _build(low, high) if self.layout is None else (*self.layout, _refit(low, high, *self.layout))
        object.__setattr__(self, "_nodes", nodes)

    def moved(self, vertices: Floats) -> TetTree:
        """The tree of the same tets over other vertices (n, 3) [mm]: made quicker, good for small motions."""
        return TetTree(vertices, self.tets, self._nodes[:-1])

    def containing(self, points: Floats, besides: Ints) -> tuple[Ints, Floats]:
        """Pairs (point, tet), shape (k, 2), of each of `points` with each tet that holds it; weights (k, 4) in it.

        Tets that have the vertex `besides`, shape (points,), of a point are left out; give -1 to leave out none.
        """
        pairs, weights = _containing(np.ascontiguousarray(points), besides, self.tets, self.corners, *self._nodes)
        return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(weights, dtype=np.float64).reshape(-1, 4)
