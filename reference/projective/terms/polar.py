"""The nearest rotation of tets in closed form, a block at a time, and their stretches: no singular vectors.

F = R S with R a rotation and S symmetric, whose eigenvalues are the signed singular values s0 >= s1 >= |s2| of F. Of
the invariants i1 = s0 + s1 + s2, i2 = s0 s1 + s0 s2 + s1 s2 and i3 = det F only i1 has to be searched for. It is the
largest root of (i1² - |F|²)² = 4 (|cof F|² + 2 i3 i1), to which Newton's method falls from √3 |F|. By Cayley and
Hamilton R (i1 i2 - i3) = i1 cof F + (i1² - i2) F - F FᵀF (Franca 1989, "An algorithm to compute the square root of a
3x3 positive definite matrix", has this form for S); and R S = F, R S² = cof F + i1 F - i2 R turn a function of S into
one of R, F and cof F.
"""

from __future__ import annotations

from math import sqrt

from numba import njit

# isort: off
from .lanes import (
    COMPILED,
    F00,
    F01,
    F02,
    F10,
    F11,
    F12,
    F20,
    F21,
    F22,
    FIRST,
    K00,
    K01,
    K02,
    K10,
    K11,
    K12,
    K20,
    K21,
    K22,
    LANES,
    MINORS,
    R00,
    R01,
    R02,
    R10,
    R11,
    R12,
    R20,
    R21,
    R22,
    S0,
    S1,
    S2,
    SECOND,
    SQUARES,
    THIRD,
)  # fmt: skip
# isort: on

MOST_STEPS = 12
"""Of Newton's method for the first invariant."""
ENOUGH = 1e-8
"""Relative size of a step after which the next would be below rounding."""
UNSURE = 0.02
"""Of (s0 + s1) (s0 + s2) (s1 + s2) over i1³, 8/27 for a rotation: below that rounding is amplified too much."""


@njit(**COMPILED)
def _invariants(w):
    """Write cof F, |F|², |cof F|², det F, and the first guess of i1."""
    for k in range(LANES):
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        d, e, f = w[F10 + k], w[F11 + k], w[F12 + k]
        g, h, i = w[F20 + k], w[F21 + k], w[F22 + k]
        k00, k01, k02 = e * i - f * h, f * g - d * i, d * h - e * g
        k10, k11, k12 = c * h - b * i, a * i - c * g, b * g - a * h
        k20, k21, k22 = b * f - c * e, c * d - a * f, a * e - b * d
        squares = (a * a + b * b + c * c) + (d * d + e * e + f * f) + (g * g + h * h + i * i)
        minors = k00 * k00 + k01 * k01 + k02 * k02 + k10 * k10 + k11 * k11 + k12 * k12
        w[K00 + k], w[K01 + k], w[K02 + k] = k00, k01, k02
        w[K10 + k], w[K11 + k], w[K12 + k] = k10, k11, k12
        w[K20 + k], w[K21 + k], w[K22 + k] = k20, k21, k22
        w[SQUARES + k], w[MINORS + k] = squares, minors + (k20 * k20 + k21 * k21 + k22 * k22)
        w[THIRD + k], w[FIRST + k] = a * k00 + b * k01 + c * k02, sqrt(3.0 * squares)


@njit(**COMPILED)
def _approach(w):
    """One step of Newton's method for i1; returns how many lanes need another."""
    pending = 0
    for k in range(LANES):
        first, third = w[FIRST + k], w[THIRD + k]
        x = first * first - w[SQUARES + k]
        step = (x * x - 4.0 * (w[MINORS + k] + 2.0 * third * first)) / (4.0 * first * x - 8.0 * third)
        w[FIRST + k] = first - step
        pending += 0 if abs(step) <= ENOUGH * first else 1
    return pending


@njit(**COMPILED)
def nearest_rotation(w):
    """Write R, cof F and the invariants of S of every lane; return how many lanes are too near to having no one R."""
    _invariants(w)
    for _ in range(MOST_STEPS):
        if _approach(w) == 0:
            break
    doubts = 0
    for k in range(LANES):
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        d, e, f = w[F10 + k], w[F11 + k], w[F12 + k]
        g, h, i = w[F20 + k], w[F21 + k], w[F22 + k]
        first, third = w[FIRST + k], w[THIRD + k]
        second = 0.5 * (first * first - w[SQUARES + k])
        product = first * second - third
        w[SECOND + k] = second
        doubts += 0 if product > UNSURE * first * first * first else 1
        scale = 1.0 / product
        cofactor, linear = first * scale, (first * first - second) * scale
        c00, c11, c22 = a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i
        c00, c11, c22 = linear - scale * c00, linear - scale * c11, linear - scale * c22
        c01, c02, c12 = a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i
        c01, c02, c12 = -scale * c01, -scale * c02, -scale * c12
        w[R00 + k] = cofactor * w[K00 + k] + (a * c00 + b * c01 + c * c02)
        w[R01 + k] = cofactor * w[K01 + k] + (a * c01 + b * c11 + c * c12)
        w[R02 + k] = cofactor * w[K02 + k] + (a * c02 + b * c12 + c * c22)
        w[R10 + k] = cofactor * w[K10 + k] + (d * c00 + e * c01 + f * c02)
        w[R11 + k] = cofactor * w[K11 + k] + (d * c01 + e * c11 + f * c12)
        w[R12 + k] = cofactor * w[K12 + k] + (d * c02 + e * c12 + f * c22)
        w[R20 + k] = cofactor * w[K20 + k] + (g * c00 + h * c01 + i * c02)
        w[R21 + k] = cofactor * w[K21 + k] + (g * c01 + h * c11 + i * c12)
        w[R22 + k] = cofactor * w[K22 + k] + (g * c02 + h * c12 + i * c22)
    return doubts


@njit(**COMPILED)
def stretches(w):
    """Write s0 >= s1 >= s2 from S = RᵀF less its mean, by the cosine of a third of an angle.

    The invariants would do, but for digits that cancel where stretches are near to one another. With 4 x³ - 3 x = y in
    [0, 1] the root x = cos(arccos(y)/3) is in [√3/2, 1], where Newton's method needs three steps. Of two stretches that
    are equal but for rounding half the digits are lost, of their symmetric functions none.
    """
    for k in range(LANES):
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        d, e, f = w[F10 + k], w[F11 + k], w[F12 + k]
        g, h, i = w[F20 + k], w[F21 + k], w[F22 + k]
        x, y, z = w[R00 + k], w[R10 + k], w[R20 + k]
        s00, s01, s02 = x * a + y * d + z * g, x * b + y * e + z * h, x * c + y * f + z * i
        x, y, z = w[R01 + k], w[R11 + k], w[R21 + k]
        s11, s12 = x * b + y * e + z * h, x * c + y * f + z * i
        s22 = w[R02 + k] * c + w[R12 + k] * f + w[R22 + k] * i
        mean = (s00 + s11 + s22) / 3.0
        s00, s11, s22 = s00 - mean, s11 - mean, s22 - mean
        squares = s00 * s00 + s11 * s11 + s22 * s22 + 2.0 * (s01 * s01 + s02 * s02 + s12 * s12)
        radius = sqrt(squares / 6.0)
        det = s00 * (s11 * s22 - s12 * s12) - s01 * (s01 * s22 - s12 * s02) + s02 * (s01 * s12 - s11 * s02)
        half = 0.5 * det
        y = min(max(half / (radius * radius * radius + 1e-300), -1.0), 1.0)
        mirrored = y < 0.0
        y = abs(y)
        x = 0.8660254037844386 + 0.1339745962155614 * y
        x -= (x * (4.0 * x * x - 3.0) - y) / (12.0 * x * x - 3.0)
        x -= (x * (4.0 * x * x - 3.0) - y) / (12.0 * x * x - 3.0)
        x -= (x * (4.0 * x * x - 3.0) - y) / (12.0 * x * x - 3.0)
        z = sqrt(3.0 * max(1.0 - x * x, 0.0))
        middle, last = 0.5 * (z - x), -0.5 * (z + x)
        w[S0 + k] = mean + 2.0 * radius * (-last if mirrored else x)
        w[S1 + k] = mean + 2.0 * radius * (-middle if mirrored else middle)
        w[S2 + k] = mean + 2.0 * radius * (-x if mirrored else last)
