"""Crossings of triangles that meet in one vertex, which a search for triangles apart leaves out."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..mesh import Floats, Ints
from .triangles import segment_hits


def fan_crossings(vertices: Floats, triangles: Ints) -> Ints:
    """Pairs of triangles with exactly one common vertex that have more in common than it, shape (k, 2).

    Two such triangles cross exactly if the side of one that lies opposite the vertex meets the other.
    """
    corners = np.argsort(triangles.ravel(), kind="stable")
    first = np.searchsorted(triangles.ravel()[corners], np.arange(len(vertices) + 1))
    found = _fan_crossings(np.ascontiguousarray(vertices), np.ascontiguousarray(triangles), corners, first)
    return np.array(found, dtype=np.int64).reshape(-1, 2)


@njit(cache=True)
def _fan_crossings(vertices, triangles, corners, first):
    found = []
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
                    found.append((t, s))
    return found
