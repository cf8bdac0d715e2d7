"""Hill-climbing of the worst tets: columns move a little wherever that improves the worst tet around them.

Freitag and Ollivier-Gooch (IJNME 40(21), 1997), with the smallest sine of the dihedral angles as the measure, which is
negative in an inverted tet: the same climb untangles and shapes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.geometry.mirror import find_middle
from ...base.kernels import njit
from ...base.mesh import Floats
from ...head.columns import Columns


@dataclass(frozen=True)
class ClimbPolicy:
    """Constants of the climb."""

    enough: float = 0.12  # sine of the dihedral angle that is left alone: 7 degrees
    flat: float = 0.75  # of a layer's thickness over the edge: flat prisms cannot be better than flat, less is enough
    least_enough: float = 0.06  # of the sine, however flat
    sweeps: int = 20
    cycle: int = 5  # sweeps over which the step shrinks, by half each, before it is long again
    shortest: float = 0.4  # of the length that a connector started with
    longest: float = 1.6  # likewise
    slide: float = 0.25  # of the mean edge: how far a vertex of the skin wrap may slide along it


POLICY = ClimbPolicy()
"""The constants as they were measured."""
ROUNDING = 1e-9
"""A sine that grows by less has not grown: twins mirror each other but for rounding."""


def improve(columns: Columns, stack: Floats, *, least: float, policy: ClimbPolicy = POLICY) -> Floats:
    """Wraps, stacked (3 n, 3) [mm] from skin to skull, whose worst tets have a better shape, close to those given.

    A column's skull and muscle vertex move together, its muscle vertex alone, and its skin vertex within the tangent
    plane; no column becomes shorter than `least` [mm]. A move is made only if the smallest sine around it grows, so
    no tet that was positive is inverted. Where columns have twins, which then have to mirror each other, both move.
    """
    n = columns.n
    length = np.linalg.norm(stack[2 * n :] - stack[:n], axis=1)
    shortest = np.maximum(policy.shortest * length, np.minimum(least, length))
    normals = columns.surface(stack[:n]).vertex_normals
    slide = policy.slide * columns.mean_edge(stack[:n])
    skin, muscle, skull = stack.reshape(3, -1, 3)
    thin = np.minimum(np.linalg.norm(muscle - skin, axis=1), np.linalg.norm(skull - muscle, axis=1))
    enough = np.clip(policy.flat * thin / columns.mean_edge(skin), policy.least_enough, policy.enough)
    bounds = (enough, shortest, policy.longest * length)
    every = np.arange(n)
    twins = every if columns.twins is None else columns.twins
    in_plane = np.zeros(n, dtype=bool) if columns.twins is None else twins == every
    mirror = (twins, in_plane, find_middle(stack.reshape(3, n, 3), twins))
    arrays = (columns.tets, columns.incident, columns.starts)
    return _climb(stack.copy(), *arrays, *mirror, *bounds, normals, slide, policy.sweeps, policy.cycle)


@njit(cache=True, error_model="numpy")
def smallest_sine(x, a, b, c, d):
    """The smallest sine of the dihedral angles, 6 V |edge| over its two faces' doubled areas, with the sign of V."""
    b0, b1, b2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    c0, c1, c2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    d0, d1, d2 = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
    p0, p1, p2 = c1 * d2 - c2 * d1, c2 * d0 - c0 * d2, c0 * d1 - c1 * d0
    q0, q1, q2 = b1 * d2 - b2 * d1, b2 * d0 - b0 * d2, b0 * d1 - b1 * d0
    r0, r1, r2 = b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0
    # The face opposite to a: (c - b) x (d - b).
    s0, s1, s2 = p0 + r0 - q0, p1 + r1 - q1, p2 + r2 - q2
    volume = b0 * p0 + b1 * p1 + b2 * p2
    nb = p0 * p0 + p1 * p1 + p2 * p2
    nc = q0 * q0 + q1 * q1 + q2 * q2
    nd = r0 * r0 + r1 * r1 + r2 * r2
    na = s0 * s0 + s1 * s1 + s2 * s2
    lab = b0 * b0 + b1 * b1 + b2 * b2
    lac = c0 * c0 + c1 * c1 + c2 * c2
    lad = d0 * d0 + d1 * d1 + d2 * d2
    lbc = (c0 - b0) ** 2 + (c1 - b1) ** 2 + (c2 - b2) ** 2
    lbd = (d0 - b0) ** 2 + (d1 - b1) ** 2 + (d2 - b2) ** 2
    lcd = (d0 - c0) ** 2 + (d1 - c1) ** 2 + (d2 - c2) ** 2
    # Squares of 1 / sine, but for the volume: the largest product over an edge belongs to the smallest sine.
    worst = max(nc * nd / lab, nb * nd / lac, nb * nc / lad, na * nd / lbc, na * nc / lbd, na * nb / lcd)
    return volume / np.sqrt(max(worst, 1e-300))


@njit(cache=True, error_model="numpy")
def _worst_around(x, tets, incident, first, last):
    worst, where = 1.0, first
    for k in range(first, last):
        t = incident[k]
        sine = smallest_sine(x, tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3])
        if sine < worst:
            worst, where = sine, k
    return worst, where


@njit(cache=True, error_model="numpy")
def _all_above(x, tets, incident, first, last, where, limit):
    """Whether all tets around are better than `limit`, and how good the worst is; the one at `where` is asked first."""
    t = incident[where]
    worst = smallest_sine(x, tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3])
    if worst <= limit:
        return False, worst
    for k in range(first, last):
        t = incident[k]
        sine = smallest_sine(x, tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3])
        if sine <= limit:
            return False, sine
        worst = min(worst, sine)
    return True, worst


@njit(cache=True, error_model="numpy")
def _direction(which, c):
    """Component c of one of 14 directions: along the axes, then to the corners of a cube."""
    if which < 6:
        return (1.0 - 2.0 * (which % 2)) * (which // 2 == c)
    return (1.0 - 2.0 * (((which - 6) >> c) % 2)) / np.sqrt(3.0)


@njit(cache=True, error_model="numpy")
def _bad_columns(x, tets, n, twins, enough):
    """Columns of tets that are not good enough; of twins the one with the smaller number."""
    bad = np.zeros(n, np.bool_)
    for t in range(len(tets)):
        sine = smallest_sine(x, tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3])
        for k in range(4):
            v = tets[t, k] % n
            if sine < enough[v]:
                bad[min(v, twins[v])] = True
    return np.flatnonzero(bad)


@njit(cache=True, error_model="numpy")
def _put(x, v, twin, middle, place, share, delta):
    """Put vertex v at place + share delta, and its twin, if it is another, at the mirror image."""
    for c in range(3):
        x[v, c] = place[c] + share * delta[c]
    if twin != v:
        x[twin, 0], x[twin, 1], x[twin, 2] = 2.0 * middle - x[v, 0], x[v, 1], x[v, 2]


@njit(cache=True, error_model="numpy")
def _climb(
    x, tets, incident, starts, twins, in_plane, middle, enough, shortest, longest, normals, slide, sweeps, cycle
):
    n = len(shortest)
    rest = x[:n].copy()
    step = np.empty((n, 3))
    for v in range(n):
        length = np.sqrt(((x[2 * n + v] - x[v]) ** 2).sum())
        step[v, 0], step[v, 1], step[v, 2] = 0.2 * length, 0.1 * length, 0.4 * slide[v]
    column, best = np.empty((3, 3)), np.empty((3, 3))
    delta = np.empty(3)
    for sweep in range(sweeps):
        if sweep % cycle == 0:
            active = _bad_columns(x, tets, n, twins, enough)
            moves = 0
        for v in active:
            first, last, twin = starts[v], starts[v + 1], twins[v]
            worst, where = _worst_around(x, tets, incident, first, last)
            if worst >= enough[v]:
                continue
            for level in range(3):
                for c in range(3):
                    column[level, c] = best[level, c] = x[level * n + v, c]
            share = np.sqrt(((column[1] - column[0]) ** 2).sum() / ((column[2] - column[0]) ** 2).sum())
            for kind in range(3):
                before = worst
                for which in range(14):
                    for c in range(3):
                        delta[c] = 0.5 ** (sweep % cycle) * step[v, kind] * _direction(which, c)
                    if in_plane[v]:
                        delta[0] = 0.0
                    for level in range(3):
                        _put(x, level * n + v, level * n + twin, middle, best[level], 0.0, delta)
                    if kind == 0:
                        _put(x, 2 * n + v, 2 * n + twin, middle, column[2], 1.0, delta)
                        _put(x, n + v, n + twin, middle, column[1], share, delta)
                    elif kind == 1:
                        _put(x, n + v, n + twin, middle, column[1], 1.0, delta)
                    else:
                        along = (delta * normals[v]).sum()
                        away = 0.0
                        for c in range(3):
                            delta[c] -= along * normals[v, c]
                            away += (column[0, c] + delta[c] - rest[v, c]) ** 2
                        if away > slide[v] ** 2:
                            continue
                        _put(x, v, twin, middle, column[0], 1.0, delta)
                    size = np.sqrt(((x[2 * n + v] - x[v]) ** 2).sum())
                    if size < shortest[v] or size > longest[v]:
                        continue
                    better, sine = _all_above(x, tets, incident, first, last, where, worst + ROUNDING)
                    if better:
                        worst = sine
                        for level in range(3):
                            for c in range(3):
                                best[level, c] = x[level * n + v, c]
                for level in range(3):
                    _put(x, level * n + v, level * n + twin, middle, best[level], 0.0, delta)
                    for c in range(3):
                        column[level, c] = best[level, c]
                if worst > before:
                    moves += 1
                    worst, where = _worst_around(x, tets, incident, first, last)
        if sweep % cycle == cycle - 1 and moves == 0:
            break
    return x
