"""Signed singular values of tets, a block at a time: F = U diag(s) Vᵀ with rotations U and V, and s0 >= s1 >= |s2|."""

from __future__ import annotations

from math import sqrt

from numba import njit

# isort: off
from .lanes import (
    C00,
    C01,
    C02,
    C11,
    C12,
    C22,
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
    LANES,
    S0,
    S1,
    S2,
    U00,
    U01,
    U02,
    U10,
    U11,
    U12,
    U20,
    U21,
    U22,
    V00,
    V01,
    V02,
    V10,
    V11,
    V12,
    V20,
    V21,
    V22,
)  # fmt: skip
# isort: on

MAX_SWEEPS = 10
"""Of Jacobi rotations; five do for tets of a face."""


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
