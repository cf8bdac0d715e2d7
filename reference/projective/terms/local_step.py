"""The local step: energy and gradient of Strain and Volume on tets, a block of LANES tets at a time.

The stress is P = R f(S), with F = R S and f the sum of the terms' principal stresses. A Strain of limit 1 needs R
alone: w (F - R). For the others f is the quadratic in S that meets the principal stresses at the three stretches
(Newton's divided differences), which needs no singular vectors. Volume's principal stress is d_i = s_i - t_i = -m/t_i,
whose differences are d[i, j] = m/(t_i t_j + m), where nothing cancels however near two stretches are.
Blocks with a tet so flat that R is not sure, or at a kink of its stress, go by singular values.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from ....lhm.base.kernels import njit

# How a block lies in memory: quantity after quantity a row of LANES numbers, so that loops over lanes vectorise. The
# rows lie in one flat array and their offsets are compile-time constants: the compiler then knows that no two rows
# overlap, and needs no run-time checks that would make it fall back to scalar code.
LANES = 32


def rows(first: int, count: int) -> tuple[int, ...]:
    """Return the offsets of so many rows from one on."""
    return tuple(LANES * row for row in range(first, first + count))


# What depends on the scene: bounds and weights (with the rest volume), per edge of a cell a row of three of how F grows
# with it, and per edge how its hourglass modes do. An edge goes from a cell's first vertex to another: three of a tet,
# which has no such mode, five of a prism, which has two.
HIGH, STRAIN2, LOW2, HIGH2 = rows(0, 4)
SELDOM_READ = 4
VOLUME, TARGET, STRAIN, LOW = rows(4, 4)
WEIGHTS = 8
GRADIENTS = LANES * WEIGHTS
MODES = LANES * 23

# What the local step computes. An edge of the displacement, a row of three, becomes the force on its end.
F00, F01, F02, F10, F11, F12, F20, F21, F22 = rows(33, 9)
S0, S1, S2 = rows(42, 3)
D0, D1, D2 = rows(45, 3)
ENERGY, DOUBT, MULTIPLIER = rows(48, 3)

# By singular values F = U diag(s) Vᵀ, with V from Jacobi's sweeps on C = FᵀF.
C00, C11, C22, C01, C02, C12 = rows(51, 6)
V00, V01, V02, V10, V11, V12, V20, V21, V22 = rows(57, 9)
U00, U01, U02, U10, U11, U12, U20, U21, U22 = rows(66, 9)

# By the nearest rotation F = R S: cofactors of F, invariants of S, and a stress R (A0 + A1 S + A2 S²).
R00, R01, R02, R10, R11, R12, R20, R21, R22 = rows(75, 9)
K00, K01, K02, K10, K11, K12, K20, K21, K22 = rows(84, 9)
FIRST, SECOND, THIRD, SQUARES, MINORS = rows(93, 5)
A0, A1, A2 = rows(98, 3)
EDGES, HELD = LANES * 101, LANES * 116
ROWS = 122

TET, PRISM = (1, 2, 3), (1, 2, 3, 4, 5)
"""The edges of a cell by the corner at their ends. A tuple, so that the compiler knows their number."""

# No fast-math: with it, code loaded from numba's cache rounds otherwise than code just compiled, and a corpus made by
# two processes would differ from one made by one. It would be a tenth faster.
COMPILED = {"cache": True, "error_model": "numpy"}

# Signed singular values of tets, a block at a time: F = U diag(s) Vᵀ with rotations U and V, and s0 >= s1 >= |s2|.

MAX_SWEEPS = 10
"""Most sweeps of Jacobi rotations; tets of a face take five."""


@njit(inline="always", **COMPILED)
def _rotation(app, aqq, apq):
    """Cosine, sine and tangent of the Jacobi rotation that annihilates apq; the identity where it is zero."""
    difference, twice = aqq - app, 2.0 * apq
    t = twice / (abs(difference) + sqrt(difference * difference + twice * twice) + 1e-300)
    t = t if difference >= 0.0 else -t
    c = 1.0 / sqrt(1.0 + t * t)
    return c, t * c, t


@njit(**COMPILED)
def _right_stretch(w):
    """C = FᵀF, and V = I to begin with."""
    for k in range(LANES):
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        d, e, f = w[F10 + k], w[F11 + k], w[F12 + k]
        g, h, i = w[F20 + k], w[F21 + k], w[F22 + k]
        w[C00 + k] = a * a + d * d + g * g
        w[C11 + k] = b * b + e * e + h * h
        w[C22 + k] = c * c + f * f + i * i
        w[C01 + k] = a * b + d * e + g * h
        w[C02 + k] = a * c + d * f + g * i
        w[C12 + k] = b * c + e * f + h * i
        w[V00 + k], w[V01 + k], w[V02 + k] = 1.0, 0.0, 0.0
        w[V10 + k], w[V11 + k], w[V12 + k] = 0.0, 1.0, 0.0
        w[V20 + k], w[V21 + k], w[V22 + k] = 0.0, 0.0, 1.0


@njit(**COMPILED)
def _sweep(w):
    """One cyclic Jacobi sweep over C and V; returns how many lanes were not yet diagonal to rounding."""
    pending = 0
    for k in range(LANES):
        c00, c11, c22 = w[C00 + k], w[C11 + k], w[C22 + k]
        c01, c02, c12 = w[C01 + k], w[C02 + k], w[C12 + k]
        trace = c00 + c11 + c22
        off = c01 * c01 + c02 * c02 + c12 * c12
        pending += 1 if off > 1e-33 * trace * trace else 0

        c, s, t = _rotation(c00, c11, c01)
        c00, c11 = c00 - t * c01, c11 + t * c01
        c02, c12 = c * c02 - s * c12, s * c02 + c * c12
        v00, v01 = c * w[V00 + k] - s * w[V01 + k], s * w[V00 + k] + c * w[V01 + k]
        v10, v11 = c * w[V10 + k] - s * w[V11 + k], s * w[V10 + k] + c * w[V11 + k]
        v20, v21 = c * w[V20 + k] - s * w[V21 + k], s * w[V20 + k] + c * w[V21 + k]

        c, s, t = _rotation(c00, c22, c02)
        c00, c22 = c00 - t * c02, c22 + t * c02
        c01, c12 = -s * c12, c * c12
        v00, v02 = c * v00 - s * w[V02 + k], s * v00 + c * w[V02 + k]
        v10, v12 = c * v10 - s * w[V12 + k], s * v10 + c * w[V12 + k]
        v20, v22 = c * v20 - s * w[V22 + k], s * v20 + c * w[V22 + k]

        c, s, t = _rotation(c11, c22, c12)
        c11, c22 = c11 - t * c12, c22 + t * c12
        c01, c02 = c * c01, s * c01
        w[C00 + k], w[C11 + k], w[C22 + k] = c00, c11, c22
        w[C01 + k], w[C02 + k], w[C12 + k] = c01, c02, 0.0
        w[V00 + k], w[V01 + k], w[V02 + k] = v00, c * v01 - s * v02, s * v01 + c * v02
        w[V10 + k], w[V11 + k], w[V12 + k] = v10, c * v11 - s * v12, s * v11 + c * v12
        w[V20 + k], w[V21 + k], w[V22 + k] = v20, c * v21 - s * v22, s * v21 + c * v22
    return pending


@njit(**COMPILED)
def _order(w, cp, v0p, v1p, v2p, cq, v0q, v1q, v2q):
    """Swap columns p and q of V where eigenvalue q is the larger; one sign changes, so that V stays a rotation."""
    for k in range(LANES):
        swap = w[cq + k] > w[cp + k]
        p, q = w[cp + k], w[cq + k]
        w[cp + k], w[cq + k] = (q if swap else p), (p if swap else q)
        p, q = w[v0p + k], w[v0q + k]
        w[v0p + k], w[v0q + k] = (q if swap else p), (-p if swap else q)
        p, q = w[v1p + k], w[v1q + k]
        w[v1p + k], w[v1q + k] = (q if swap else p), (-p if swap else q)
        p, q = w[v2p + k], w[v2q + k]
        w[v2p + k], w[v2q + k] = (q if swap else p), (-p if swap else q)


@njit(**COMPILED)
def _left_vectors(w):
    """U and s from B = F V by Gram-Schmidt, the longest column first; any frame where F is a line or a point."""
    for k in range(LANES):
        f00, f01, f02 = w[F00 + k], w[F01 + k], w[F02 + k]
        f10, f11, f12 = w[F10 + k], w[F11 + k], w[F12 + k]
        f20, f21, f22 = w[F20 + k], w[F21 + k], w[F22 + k]

        a, b, c = w[V00 + k], w[V10 + k], w[V20 + k]
        x, y, z = f00 * a + f01 * b + f02 * c, f10 * a + f11 * b + f12 * c, f20 * a + f21 * b + f22 * c
        first = sqrt(x * x + y * y + z * z)
        scale = 1.0 / max(first, 1e-150)
        point = not first > 1e-150
        ux, uy, uz = (1.0 if point else x * scale), y * scale, z * scale

        a, b, c = w[V01 + k], w[V11 + k], w[V21 + k]
        x, y, z = f00 * a + f01 * b + f02 * c, f10 * a + f11 * b + f12 * c, f20 * a + f21 * b + f22 * c
        along = ux * x + uy * y + uz * z
        x, y, z = x - along * ux, y - along * uy, z - along * uz
        second = sqrt(x * x + y * y + z * z)
        line = not second > 1e-14 * first
        steep = abs(ux) > 0.9
        along = uy if steep else ux
        x = (0.0 if steep else 1.0) - along * ux if line else x
        y = (1.0 if steep else 0.0) - along * uy if line else y
        z = -along * uz if line else z
        scale = 1.0 / sqrt(x * x + y * y + z * z)
        vx, vy, vz = x * scale, y * scale, z * scale

        wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        a, b, c = w[V02 + k], w[V12 + k], w[V22 + k]
        x, y, z = f00 * a + f01 * b + f02 * c, f10 * a + f11 * b + f12 * c, f20 * a + f21 * b + f22 * c
        w[S0 + k], w[S1 + k], w[S2 + k] = first, (0.0 if line else second), wx * x + wy * y + wz * z
        w[U00 + k], w[U10 + k], w[U20 + k] = ux, uy, uz
        w[U01 + k], w[U11 + k], w[U21 + k] = vx, vy, vz
        w[U02 + k], w[U12 + k], w[U22 + k] = wx, wy, wz


@njit(**COMPILED)
def decompose(w):
    """F = U diag(s) Vᵀ of every lane: Jacobi on FᵀF until all lanes are diagonal, then B = F V.

    The residual F - U diag(s) Vᵀ is a few roundings of s0, repeated and zero singular values included.
    """
    _right_stretch(w)
    for _ in range(MAX_SWEEPS):
        if _sweep(w) == 0:
            break
    _order(w, C00, V00, V10, V20, C11, V01, V11, V21)
    _order(w, C11, V01, V11, V21, C22, V02, V12, V22)
    _order(w, C00, V00, V10, V20, C11, V01, V11, V21)
    _left_vectors(w)


# The nearest rotation of tets in closed form, a block at a time, and their stretches: no singular vectors.
#
# F = R S with R a rotation and S symmetric, whose eigenvalues are the signed singular values s0 >= s1 >= |s2| of F. Of
# the invariants i1 = s0 + s1 + s2, i2 = s0 s1 + s0 s2 + s1 s2 and i3 = det F only i1 has to be searched for. It is the
# largest root of (i1² - |F|²)² = 4 (|cof F|² + 2 i3 i1), to which Newton's method falls from √3 |F|. By Cayley and
# Hamilton R (i1 i2 - i3) = i1 cof F + (i1² - i2) F - F FᵀF (Franca 1989, "An algorithm to compute the square root of a
# 3x3 positive definite matrix", has this form for S); and R S = F, R S² = cof F + i1 F - i2 R turn a function of S into
# one of R, F and cof F.

INVARIANT_STEPS = 12
"""Most steps of Newton's method for the first invariant."""
SMALL_STEP = 1e-8
"""Relative size of a step after which the next would be below rounding."""
UNSURE = 0.02
"""Least (s0 + s1) (s0 + s2) (s1 + s2) / i1³, 8/27 for a rotation: below it rounding is amplified too much."""


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
def _approach_invariant(w):
    """One step of Newton's method for i1; returns how many lanes need another."""
    pending = 0
    for k in range(LANES):
        first, third = w[FIRST + k], w[THIRD + k]
        x = first * first - w[SQUARES + k]
        step = (x * x - 4.0 * (w[MINORS + k] + 2.0 * third * first)) / (4.0 * first * x - 8.0 * third)
        w[FIRST + k] = first - step
        pending += 0 if abs(step) <= SMALL_STEP * first else 1
    return pending


@njit(**COMPILED)
def nearest_rotation(w):
    """Write R, cof F and the invariants of S of every lane; return how many lanes are too near to having no one R."""
    _invariants(w)
    for _ in range(INVARIANT_STEPS):
        if _approach_invariant(w) == 0:
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


# The nearest volume of tets, a block at a time: stretches t of a determinant v > 0 nearest to stretches s.
#
# The nearest matrix of determinant v (SoftDECA Eq. 10, after ShapeOp) is U diag(t) Vᵀ, since v > 0, with t of
# min Σ (t_i - s_i)² subject to t0 t1 t2 = v. The stationary points have t_i (t_i - s_i) = m for one multiplier m, so
# t_i = (s_i ± √(s_i² + 4 m))/2, and what is left is one equation for m.

MULTIPLIER_STEPS = 12
"""Most steps of Newton's method for the multiplier; small changes take three."""
SMALL_ERROR = 1e-8
"""Relative error of the determinant after which one step more is exact to rounding."""
SCAN = 256
"""Steps of the search for roots where Newton's method is in doubt."""


@njit(**COMPILED)
def _first_multiplier(w):
    """Write the first multiplier: 0, or of tets that are flat or inverted one for which t2 is positive."""
    for k in range(LANES):
        s0, s1, s2, v = w[S0 + k], w[S1 + k], w[S2 + k], w[TARGET + k]
        area = s0 * s1
        t2 = 0.5 * v / (area + 0.3 * v)
        w[MULTIPLIER + k] = t2 * (t2 - s2) if area * s2 < 0.2 * v and t2 > s2 else 0.0


@njit(**COMPILED)
def _approach_multiplier(w):
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
        pending += 0 if abs(v - product) <= SMALL_ERROR * v else 1
    return pending


@njit(**COMPILED)
def _distances(w):
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
    _first_multiplier(w)
    for _ in range(MULTIPLIER_STEPS):
        if _approach_multiplier(w) == 0:
            break
    if _distances(w) > 0:
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


# The local step.

HAS_VOLUME, HAS_BOUNDS, HAS_GUARDS = 1, 2, 4
"""Flags of a block: a volume, a first Strain that is not of limit 1, a second Strain."""
NEAR = 1e-8
"""Where two stretches differ by less, a difference quotient is taken for the derivative."""
CLOSE = 1e-5
"""Stretches that are nearer to one another and to a bound are not exact enough by invariants."""
ALIKE = 1e-3
"""Share of t_i t_j below which t_i t_j + m is lost in rounding."""


@njit(**COMPILED)
def _read_bounds(w, parameters):
    """Copy the parameters of a block that not every block needs."""
    for i in range(SELDOM_READ * LANES):
        w[i] = parameters[i]


@njit(**COMPILED)
def gather(w, parameters, corners, edges, kinds, u):
    """Copy a block's parameters, and compute F = I + Σ e ⊗ g over the edges e of the displacement u.

    Guards' parameters are left out. From displacements, for differences of positions far from the origin lose digits.
    """
    for i in range(SELDOM_READ * LANES, (WEIGHTS + len(edges) * len(edges)) * LANES):  # 3 and a mode's share per edge
        w[i] = parameters[i]
    if kinds & HAS_BOUNDS:
        _read_bounds(w, parameters)
    for k in range(LANES):
        first = corners[k]
        x, y, z = u[first, 0], u[first, 1], u[first, 2]
        for edge in range(len(edges)):
            end, row = corners[(edge + 1) * LANES + k], EDGES + 3 * edge * LANES + k
            w[row], w[row + LANES], w[row + 2 * LANES] = u[end, 0] - x, u[end, 1] - y, u[end, 2] - z
    for k in range(LANES):
        f00, f01, f02, f10, f11, f12, f20, f21, f22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for edge in range(len(edges)):
            row = 3 * edge * LANES + k
            x, y, z = w[EDGES + row], w[EDGES + row + LANES], w[EDGES + row + 2 * LANES]
            a, b, c = w[GRADIENTS + row], w[GRADIENTS + row + LANES], w[GRADIENTS + row + 2 * LANES]
            f00, f01, f02 = f00 + x * a, f01 + x * b, f02 + x * c
            f10, f11, f12 = f10 + y * a, f11 + y * b, f12 + y * c
            f20, f21, f22 = f20 + z * a, f21 + z * b, f22 + z * c
        w[F00 + k], w[F01 + k], w[F02 + k] = 1.0 + f00, f01, f02
        w[F10 + k], w[F11 + k], w[F12 + k] = f10, 1.0 + f11, f12
        w[F20 + k], w[F21 + k], w[F22 + k] = f20, f21, 1.0 + f22


@njit(**COMPILED)
def _see_modes(w, edges):
    """Write Σ h e over the edges e of every hourglass mode h."""
    for k in range(LANES):
        for mode in range(len(edges) - 3):
            x, y, z = 0.0, 0.0, 0.0
            for edge in range(len(edges)):
                row, share = EDGES + 3 * edge * LANES + k, w[MODES + ((len(edges) - 3) * edge + mode) * LANES + k]
                x, y, z = x + share * w[row], y + share * w[row + LANES], z + share * w[row + 2 * LANES]
            row = HELD + 3 * mode * LANES + k
            w[row], w[row + LANES], w[row + 2 * LANES] = x, y, z


@njit(**COMPILED)
def _hold_modes(w, edges):
    """Add the forces and the energy by which hourglass modes are held."""
    for k in range(LANES):
        for mode in range(len(edges) - 3):
            row = HELD + 3 * mode * LANES + k
            x, y, z = w[row], w[row + LANES], w[row + 2 * LANES]
            w[ENERGY + k] += 0.5 * (x * x + y * y + z * z)
            for edge in range(len(edges)):
                row, share = EDGES + 3 * edge * LANES + k, w[MODES + ((len(edges) - 3) * edge + mode) * LANES + k]
                w[row] += share * x
                w[row + LANES] += share * y
                w[row + 2 * LANES] += share * z


@njit(**COMPILED)
def _volume_stress(w):
    """Begin the quadratic and the energy of every lane with Volume's; return whether no lane has its d as a quotient.

    Equal stretches of which the nearest volume shrinks one have none: which one is for singular vectors to say.
    """
    alike = 0
    for k in range(LANES):
        s0, s1 = w[S0 + k], w[S1 + k]
        d0, d1, d2 = w[D0 + k], w[D1 + k], w[D2 + k]
        t0, t1, t2 = s0 - d0, s1 - d1, w[S2 + k] - d2
        volume, m = w[VOLUME + k], w[MULTIPLIER + k]
        alike += 0 if abs(t1 * t2 + m) > ALIKE * t1 * t2 else 1
        first = m / (t0 * t1 + m)
        second = -first * t0 * t1 * t2 / ((t0 * t2 + m) * (t1 * t2 + m))
        w[A0 + k] = volume * (d0 - first * s0 + second * s0 * s1)
        w[A1 + k], w[A2 + k] = volume * (first - second * (s0 + s1)), volume * second
        w[ENERGY + k] = 0.5 * volume * (d0 * d0 + d1 * d1 + d2 * d2)
    return alike == 0


@njit(**COMPILED)
def _is_guarded(w, parameters):
    """Whether a lane's stretches come near to a bound of its second Strain, or pass it."""
    near = 0
    for k in range(LANES):
        top, bottom = parameters[HIGH2 + k] - 2.0 * CLOSE, parameters[LOW2 + k] + 2.0 * CLOSE
        near += 1 if (w[S0 + k] > top or w[S2 + k] < bottom) and parameters[STRAIN2 + k] > 0.0 else 0
    return near > 0


@njit(**COMPILED)
def _acts(w, strain, low, high):
    """Whether a lane's Strain acts at its stretches."""
    acting = 0
    for k in range(LANES):
        beyond = (w[S0 + k] > w[high + k]) or (w[S2 + k] < w[low + k])
        acting += 1 if beyond and w[strain + k] > 0.0 else 0
    return acting > 0


@njit(**COMPILED)
def _at_corner(w, strain, low, high):
    """Whether a lane has two stretches all but equal, and at a bound of its Strain, where its stress has a kink."""
    count = 0
    for k in range(LANES):
        s0, s1, s2, bottom, top = w[S0 + k], w[S1 + k], w[S2 + k], w[low + k], w[high + k]
        upper = s0 - s1 < CLOSE and (abs(s1 - top) < CLOSE or abs(s1 - bottom) < CLOSE)
        lower = s1 - s2 < CLOSE and (abs(s1 - top) < CLOSE or abs(s1 - bottom) < CLOSE)
        count += 1 if (upper or lower) and bottom < top and w[strain + k] > 0.0 else 0
    return count > 0


@njit(**COMPILED)
def _bounded_stress(w, strain, low, high):
    """Add a Strain of any limit to the quadratic and the energy of every lane."""
    for k in range(LANES):
        s0, s1, s2, bottom, top = w[S0 + k], w[S1 + k], w[S2 + k], w[low + k], w[high + k]
        weight = w[strain + k]
        d0 = s0 - min(max(s0, bottom), top)
        d1 = s1 - min(max(s1, bottom), top)
        d2 = s2 - min(max(s2, bottom), top)
        inside = 0.0 if s1 > bottom and s1 < top else 1.0
        first = (d0 - d1) / (s0 - s1) if s0 - s1 > NEAR else inside
        other = (d1 - d2) / (s1 - s2) if s1 - s2 > NEAR else inside
        second = (first - other) / (s0 - s2) if s0 - s2 > NEAR else 0.0
        w[A0 + k] += weight * (d0 - first * s0 + second * s0 * s1)
        w[A1 + k] += weight * (first - second * (s0 + s1))
        w[A2 + k] += weight * second
        w[ENERGY + k] += 0.5 * weight * (d0 * d0 + d1 * d1 + d2 * d2)


@njit(**COMPILED)
def _forces(w, edges):
    """Write the forces P g on the ends of all edges, and add limit 1's energy."""
    for k in range(LANES):
        strain, size = w[STRAIN + k], w[LOW + k]
        quadratic = w[A2 + k]
        turned = w[A0 + k] - quadratic * w[SECOND + k]
        linear = w[A1 + k] + quadratic * w[FIRST + k]
        f0, f1, f2 = w[F00 + k], w[F01 + k], w[F02 + k]
        r0, r1, r2 = w[R00 + k], w[R01 + k], w[R02 + k]
        a, b, c = f0 - size * r0, f1 - size * r1, f2 - size * r2
        squares = a * a + b * b + c * c
        p00 = strain * a + turned * r0 + linear * f0 + quadratic * w[K00 + k]
        p01 = strain * b + turned * r1 + linear * f1 + quadratic * w[K01 + k]
        p02 = strain * c + turned * r2 + linear * f2 + quadratic * w[K02 + k]
        f0, f1, f2 = w[F10 + k], w[F11 + k], w[F12 + k]
        r0, r1, r2 = w[R10 + k], w[R11 + k], w[R12 + k]
        a, b, c = f0 - size * r0, f1 - size * r1, f2 - size * r2
        squares += a * a + b * b + c * c
        p10 = strain * a + turned * r0 + linear * f0 + quadratic * w[K10 + k]
        p11 = strain * b + turned * r1 + linear * f1 + quadratic * w[K11 + k]
        p12 = strain * c + turned * r2 + linear * f2 + quadratic * w[K12 + k]
        f0, f1, f2 = w[F20 + k], w[F21 + k], w[F22 + k]
        r0, r1, r2 = w[R20 + k], w[R21 + k], w[R22 + k]
        a, b, c = f0 - size * r0, f1 - size * r1, f2 - size * r2
        squares += a * a + b * b + c * c
        p20 = strain * a + turned * r0 + linear * f0 + quadratic * w[K20 + k]
        p21 = strain * b + turned * r1 + linear * f1 + quadratic * w[K21 + k]
        p22 = strain * c + turned * r2 + linear * f2 + quadratic * w[K22 + k]
        for edge in range(len(edges)):
            row = 3 * edge * LANES + k
            a, b, c = w[GRADIENTS + row], w[GRADIENTS + row + LANES], w[GRADIENTS + row + 2 * LANES]
            w[EDGES + row] = p00 * a + p01 * b + p02 * c
            w[EDGES + row + LANES] = p10 * a + p11 * b + p12 * c
            w[EDGES + row + 2 * LANES] = p20 * a + p21 * b + p22 * c
        w[ENERGY + k] += 0.5 * strain * squares


@njit(**COMPILED)
def _forces_by_frames(w, edges):
    """Write the forces of P = U diag(p) Vᵀ as `_forces` does, and the energy, by singular vectors."""
    p = np.empty(3)
    for k in range(LANES):
        d = w[D0 + k], w[D1 + k], w[D2 + k]
        s = w[S0 + k], w[S1 + k], w[S2 + k]
        energy, weight, first, other = 0.0, w[VOLUME + k], w[STRAIN + k], w[STRAIN2 + k]
        for i in range(3):
            energy += weight * d[i] * d[i]
            a = s[i] - min(max(s[i], w[LOW + k]), w[HIGH + k])
            b = s[i] - min(max(s[i], w[LOW2 + k]), w[HIGH2 + k])
            p[i] = weight * d[i] + first * a + other * b
            energy += first * a * a + other * b * b
        w[ENERGY + k] = 0.5 * energy
        for edge in range(len(edges)):
            for r in range(3):
                total = 0.0
                for i in range(3):
                    along = 0.0
                    for c in range(3):
                        along += w[V00 + (3 * c + i) * LANES + k] * w[GRADIENTS + (3 * edge + c) * LANES + k]
                    total += w[U00 + (3 * r + i) * LANES + k] * p[i] * along
                w[EDGES + (3 * edge + r) * LANES + k] = total


@njit(**COMPILED)
def _scatter(w, corners, edges, gradient):
    """Add a block's forces to the gradient, and minus their sum at the first vertex of each cell."""
    total = 0.0
    for k in range(LANES):
        total += w[ENERGY + k]
        x, y, z = 0.0, 0.0, 0.0
        for edge in range(len(edges)):
            end, row = corners[(edge + 1) * LANES + k], EDGES + 3 * edge * LANES + k
            p, q, s = w[row], w[row + LANES], w[row + 2 * LANES]
            x, y, z = x + p, y + q, z + s
            gradient[end, 0] += p
            gradient[end, 1] += q
            gradient[end, 2] += s
        first = corners[k]
        gradient[first, 0] -= x
        gradient[first, 1] -= y
        gradient[first, 2] -= z
    return total


@njit(**COMPILED)
def singular_stretches(w, parameters, kinds):
    """Write U, s and V of a block, and s - t to D, which is 0 where the block has no Volume."""
    _read_bounds(w, parameters)
    decompose(w)
    w[D0 : D0 + 3 * LANES] = 0.0
    if kinds & HAS_VOLUME:
        project_volume(w)


@njit(nogil=True, **COMPILED)
def add_cells(parameters, corners, edges, kinds, u, gradient):
    """Add the cells' gradient [mN] at displacement u [mm], both (n, 3), in place; return their energy [µJ].

    parameters (blocks, rows * LANES) and corners (blocks, vertices * LANES) lie as said above; kinds (blocks,) tells
    what each block asks for; edges is TET or PRISM. Guards, which hardly ever act, cost a look at the stretches.
    """
    w = np.zeros(ROWS * LANES)
    total = 0.0
    for block in range(len(parameters)):
        kind = kinds[block]
        gather(w, parameters[block], corners[block], edges, kind, u)
        if len(edges) > 3:
            _see_modes(w, edges)
        sure = nearest_rotation(w) == 0
        guarded = False
        if sure and kind:
            stretches(w)
            guarded = kind & HAS_GUARDS and _is_guarded(w, parameters[block])
            if guarded:
                _read_bounds(w, parameters[block])
            at_bound = kind & HAS_BOUNDS and _at_corner(w, STRAIN, LOW, HIGH)
            sure = not (at_bound or (guarded and _at_corner(w, STRAIN2, LOW2, HIGH2)))
        if sure and kind & HAS_VOLUME:
            project_volume(w)
            sure = _volume_stress(w)
        elif sure:
            w[A0 : A0 + 3 * LANES] = 0.0
            w[ENERGY : ENERGY + LANES] = 0.0
        if not sure:
            singular_stretches(w, parameters[block], kind)
            _forces_by_frames(w, edges)
        else:
            if kind & HAS_BOUNDS:
                _bounded_stress(w, STRAIN, LOW, HIGH)
                w[STRAIN : STRAIN + LANES] = 0.0
            if guarded and _acts(w, STRAIN2, LOW2, HIGH2):
                _bounded_stress(w, STRAIN2, LOW2, HIGH2)
            _forces(w, edges)
        if len(edges) > 3:
            _hold_modes(w, edges)
        total += _scatter(w, corners[block], edges, gradient)
    return total
