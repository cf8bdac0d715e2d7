"""Hill-climbing of the worst tets: connectors move a little wherever that improves the worst tet around them."""

from __future__ import annotations

import numba
import numpy as np

from ..layers import prism_tets
from ..mesh import Floats, Ints

ENOUGH = 0.2  # mean ratio that is left alone
SWEEPS = 60
SHORTEST, LONGEST = 0.6, 1.5  # of the length that a connector started with


def improved(skin: Floats, connectors: Floats, triangles: Ints, *, muscle: float, least: float) -> Floats:
    """Connectors (n, 3) [mm] whose worst tets have a better shape, close to those given.

    The muscle wrap lies at the fraction `muscle` of each connector; none becomes shorter than `least` [mm]. A move is
    made only if the smallest mean ratio (Liu and Joe 1994) of the tets around a connector grows, so no tet that was
    positive is inverted.
    """
    n = len(skin)
    tets = np.vstack([prism_tets(triangles, 0, n), prism_tets(triangles, n, 2 * n)])
    owner = (tets % n).ravel()
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], np.arange(n + 1))
    length = np.linalg.norm(connectors, axis=1)
    shortest = np.maximum(SHORTEST * length, np.minimum(least, length))
    return _climb(skin, connectors.copy(), tets, order // 4, starts, shortest, LONGEST * length, muscle)


@numba.njit(cache=True, error_model="numpy")
def mean_ratio(x, a, b, c, d):
    """12 (3 V)^(2/3) over the sum of squared edges: 1 for a regular tet, 0 for a flat one, negative for an inverted."""
    squares = 0.0
    for i, j in ((a, b), (a, c), (a, d), (b, c), (b, d), (c, d)):
        for k in range(3):
            squares += (x[j, k] - x[i, k]) ** 2
    p0, p1, p2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    q0, q1, q2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    r0, r1, r2 = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
    half = 0.5 * (r0 * (p1 * q2 - p2 * q1) + r1 * (p2 * q0 - p0 * q2) + r2 * (p0 * q1 - p1 * q0))
    return np.sign(half) * 12.0 * np.abs(half) ** (2.0 / 3.0) / squares


@numba.njit(cache=True, error_model="numpy")
def _worst_around(x, tets, around):
    worst = 1.0
    for t in around:
        worst = min(worst, mean_ratio(x, tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]))
    return worst


@numba.njit(cache=True, error_model="numpy")
def _place(x, n, v, connector, muscle):
    for k in range(3):
        x[n + v, k] = x[v, k] + muscle * connector[k]
        x[2 * n + v, k] = x[v, k] + connector[k]


@numba.njit(cache=True, error_model="numpy")
def _climb(skin, connectors, tets, incident, starts, shortest, longest, muscle):
    n = len(skin)
    x = np.empty((3 * n, 3))
    x[:n] = skin
    for v in range(n):
        _place(x, n, v, connectors[v], muscle)
    step = 0.2 * np.sqrt((connectors**2).sum(axis=1))
    trial, best = np.empty(3), np.empty(3)
    for _ in range(SWEEPS):
        moves = 0
        for v in range(n):
            around = incident[starts[v] : starts[v + 1]]
            worst = _worst_around(x, tets, around)
            if worst >= ENOUGH:
                continue
            before, best[:] = worst, connectors[v]
            for direction in range(14):
                for k in range(3):
                    if direction < 6:
                        offset = (1.0 - 2.0 * (direction % 2)) * (direction // 2 == k)
                    else:
                        offset = (1.0 - 2.0 * (((direction - 6) >> k) % 2)) / np.sqrt(3.0)
                    trial[k] = connectors[v, k] + step[v] * offset
                size = np.sqrt((trial**2).sum())
                if size < shortest[v] or size > longest[v]:
                    continue
                _place(x, n, v, trial, muscle)
                quality = _worst_around(x, tets, around)
                if quality > worst:
                    worst, best[:] = quality, trial
            connectors[v] = best
            _place(x, n, v, best, muscle)
            if worst > before:
                moves += 1
            else:
                step[v] *= 0.5
        if moves == 0:
            break
    return connectors
