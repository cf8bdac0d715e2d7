"""Find pairs of a surface that are near, and the step at which the first meets; see `terms.gaps` for distances."""

from __future__ import annotations

import numpy as np

from ....lhm.base.kernels import njit
from ..terms.gaps import measure_pair

CHECKED = 200
"""Steps of conservative advancement a pair at most: by then it is so near that the way ends there."""


@njit(cache=True)
def _box_gap(x, pair, between_edges):
    """Return a lower bound of a pair's distance: that of the boxes about its sides."""
    a, b, c, d = pair
    squared = 0.0
    for k in range(3):
        low = min(x[c, k], x[d, k])
        high = max(x[c, k], x[d, k])
        if between_edges:
            other_low, other_high = min(x[a, k], x[b, k]), max(x[a, k], x[b, k])
        else:
            low, high = min(low, x[b, k]), max(high, x[b, k])
            other_low = other_high = x[a, k]
        gap = max(low - other_high, other_low - high, 0.0)
        squared += gap * gap
    return np.sqrt(squared)


@njit(cache=True)
def measure_near(x, pairs, of_vertices, reach):
    """Measure the pairs (r, 4) nearer than `reach` [mm]: their places, weights (n, 4), normals (n, 3), distances (n,).

    The first `of_vertices` pairs are of vertices and triangles.
    """
    which = np.empty(len(pairs), np.int64)
    weights, normals, found = np.empty((len(pairs), 4)), np.empty((len(pairs), 3)), np.empty(len(pairs))
    corners = np.empty((4, 3))
    count = 0
    for i in range(len(pairs)):
        between_edges = i >= of_vertices
        if _box_gap(x, pairs[i], between_edges) >= reach:
            continue
        for j in range(4):
            for k in range(3):
                corners[j, k] = x[pairs[i, j], k]
        distance = measure_pair(corners, between_edges, weights[count], normals[count])
        if distance < reach:
            which[count], found[count] = i, distance
            count += 1
    return which[:count], weights[:count], normals[:count], found[:count]


@njit(cache=True)
def find_free_share(x, step, pairs, of_vertices, kept):
    """Find the largest share <= 1 of a step (k, 3) [mm] on which no pair comes nearer than `kept` of its distance.

    By additive continuous collision detection (Li, Kaufman and Jiang 2021, "Codimensional incremental potential
    contact", Algorithm 1).
    """
    best = 1.0
    corners, motion = np.empty((4, 3)), np.empty((4, 3))
    weights, normal, speeds = np.empty(4), np.empty(3), np.empty(4)
    for i in range(len(pairs)):
        between_edges = i >= of_vertices
        for k in range(3):
            mean = 0.0
            for j in range(4):
                corners[j, k], motion[j, k] = x[pairs[i, j], k], step[pairs[i, j], k]
                mean += 0.25 * motion[j, k]
            for j in range(4):
                motion[j, k] -= mean
        for j in range(4):
            speeds[j] = np.sqrt(motion[j, 0] ** 2 + motion[j, 1] ** 2 + motion[j, 2] ** 2)
        if between_edges:
            speed = max(speeds[0], speeds[1]) + max(speeds[2], speeds[3])
        else:
            speed = speeds[0] + max(speeds[1], speeds[2], speeds[3])
        if speed < 1e-14 or _box_gap(x, pairs[i], between_edges) > speed * best / (1.0 - kept):
            continue
        distance = measure_pair(corners, between_edges, weights, normal)
        goal, share = kept * distance, 0.0
        for _ in range(CHECKED):
            advance = 0.9 * (distance - goal) / speed
            if share + advance >= best:
                share = best
                break
            share += advance
            for j in range(4):
                for k in range(3):
                    corners[j, k] += advance * motion[j, k]
            distance = measure_pair(corners, between_edges, weights, normal)
            if distance <= 1.1 * goal:
                break
        best = min(best, share)
    return best
