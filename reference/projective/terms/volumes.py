"""The nearest volume of tets, a block at a time: stretches t of a determinant v > 0 nearest to stretches s.

The nearest matrix of determinant v (SoftDECA Eq. 10, after ShapeOp) is U diag(t) Vᵀ, since v > 0, with t of
min Σ (t_i - s_i)² subject to t0 t1 t2 = v. The stationary points have t_i (t_i - s_i) = m for one multiplier m, so
t_i = (s_i ± √(s_i² + 4 m))/2, and what is left is one equation for m.
"""

from __future__ import annotations

from math import sqrt

from numba import njit

from .lanes import (
    COMPILED,
    D0,
    D1,
    D2,
    DOUBT,
    LANES,
    MULTIPLIER,
    S0,
    S1,
    S2,
    TARGET,
)

STEPS = 12
"""Of Newton's method for the multiplier, at most; three do where little is to change."""
ENOUGH = 1e-8
"""Relative error of the determinant after which one step more is exact to rounding."""
SCAN = 256
"""Steps of the search for roots where Newton's method is in doubt."""


@njit(**COMPILED)
def _begin(w):
    """Write the first multiplier: 0, or of tets that are flat or inverted one for which t2 is positive."""
    for k in range(LANES):
        s0, s1, s2, v = w[S0 + k], w[S1 + k], w[S2 + k], w[TARGET + k]
        area = s0 * s1
        t2 = 0.5 * v / (area + 0.3 * v)
        w[MULTIPLIER + k] = t2 * (t2 - s2) if area * s2 < 0.2 * v and t2 > s2 else 0.0


@njit(**COMPILED)
def _approach(w):
    """One step of Newton's method for ln(t0 t1 t2 / v) = 0, with ln by its Padé form; returns how many need another.

    m stays above the least value for which t2 is real and positive.
    """
    pending = 0
    for k in range(LANES):
        s0, s1, s2, v, m = w[S0 + k], w[S1 + k], w[S2 + k], w[TARGET + k], w[MULTIPLIER + k]
        r0, r1, r2 = sqrt(s0 * s0 + 4.0 * m), sqrt(s1 * s1 + 4.0 * m), sqrt(s2 * s2 + 4.0 * m)
        t0, t1 = 0.5 * (s0 + r0), 0.5 * (s1 + r1)
        t2 = 0.5 * (s2 + r2) if s2 > 0.0 else 2.0 * m / (r2 - s2)
        product = t0 * t1 * t2
        slope = t1 * t2 * r1 * r2 + t0 * t2 * r0 * r2 + t0 * t1 * r0 * r1
        change = 2.0 * (v - product) * product * r0 * r1 * r2 / ((v + product) * slope)
        least = -0.25 * s2 * s2 if s2 > 0.0 else 0.0
        w[MULTIPLIER + k] = max(m + change, 0.5 * (m + least))
        pending += 0 if abs(v - product) <= ENOUGH * v else 1
    return pending


@njit(**COMPILED)
def _finish(w):
    """Write s - t, and which lanes are in doubt; return how many.

    A lane is in doubt where Newton's method has not converged, or where t2 comes near s2 / 2, the end of that branch,
    beyond which the nearest point has a minus. So may the nearest point of stretches that differ by less than 6.1 %, of
    a product above six times v, though this branch has one too.
    """
    doubts = 0
    for k in range(LANES):
        s0, s1, s2, v, m = w[S0 + k], w[S1 + k], w[S2 + k], w[TARGET + k], w[MULTIPLIER + k]
        t0, t1 = 0.5 * (s0 + sqrt(s0 * s0 + 4.0 * m)), 0.5 * (s1 + sqrt(s1 * s1 + 4.0 * m))
        r2 = sqrt(s2 * s2 + 4.0 * m)
        t2 = 0.5 * (s2 + r2) if s2 > 0.0 else 2.0 * m / (r2 - s2)
        several = (s0 < 1.1 * s2) and (s0 * s1 * s2 > 5.9 * v)
        sure = (abs(t0 * t1 * t2 - v) <= 1e-14 * v) and (t2 >= 0.51 * s2) and not several
        w[D0 + k], w[D1 + k], w[D2 + k] = -m / t0, -m / t1, -m / t2
        w[DOUBT + k] = 0.0 if sure else 1.0
        doubts += 0 if sure else 1
    return doubts


@njit(**COMPILED)
def project_volume(w):
    """Write s - t of every lane to D, and the multiplier m; all roots with plus where that is sure to be nearest."""
    _begin(w)
    for _ in range(STEPS):
        if _approach(w) == 0:
            break
    if _finish(w) > 0:
        _settle_doubts(w)


@njit(inline="always", **COMPILED)
def _on_path(s0, s1, s2, t2):
    """The stationary points as a path: the other two roots (with plus) for a given t2."""
    m = t2 * (t2 - s2)
    t0 = 0.5 * (s0 + sqrt(max(s0 * s0 + 4.0 * m, 0.0)))
    t1 = 0.5 * (s1 + sqrt(max(s1 * s1 + 4.0 * m, 0.0)))
    return t0, t1


@njit(**COMPILED)
def _bisect(s0, s1, s2, v, low, high):
    """The t2 in [low, high] at which the path's product reaches v, to rounding."""
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        t0, t1 = _on_path(s0, s1, s2, middle)
        if t0 * t1 * middle < v:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@njit(**COMPILED)
def nearest_of_determinant(s0, s1, s2, v):
    """The t of determinant v > 0 nearest to s0 >= s1 >= |s2|, wherever s is: slow, but sure.

    For s of a determinant below v the product grows along the path and has one root. Above it, it may have three:
    all that a scan sees are compared (a stretch to twice the size is nearer to a flat than to a round shape).
    """
    if s0 * s1 * s2 <= v:
        low = max(s2, 0.0)
        high = low + v ** (1.0 / 3.0)
        t2 = _bisect(s0, s1, s2, v, low, high)
        t0, t1 = _on_path(s0, s1, s2, t2)
        return t0, t1, t2
    best, best0, best1, best2 = 1e300, s0, s1, s2
    low = 0.0
    for step in range(1, SCAN + 1):
        high = s2 * step / SCAN
        t0, t1 = _on_path(s0, s1, s2, low)
        u0, u1 = _on_path(s0, s1, s2, high)
        if t0 * t1 * low < v <= u0 * u1 * high:
            t2 = _bisect(s0, s1, s2, v, low, high)
            t0, t1 = _on_path(s0, s1, s2, t2)
            distance = (t0 - s0) ** 2 + (t1 - s1) ** 2 + (t2 - s2) ** 2
            if distance < best:
                best, best0, best1, best2 = distance, t0, t1, t2
        low = high
    return best0, best1, best2


@njit(**COMPILED)
def _settle_doubts(w):
    """Redo the lanes in doubt by `nearest_of_determinant`."""
    for k in range(LANES):
        if w[DOUBT + k] > 0.0:
            s0, s1, s2 = w[S0 + k], w[S1 + k], w[S2 + k]
            t0, t1, t2 = nearest_of_determinant(s0, s1, s2, w[TARGET + k])
            w[D0 + k], w[D1 + k], w[D2 + k] = s0 - t0, s1 - t1, s2 - t2
            w[MULTIPLIER + k] = t2 * (t2 - s2)
