"""The local step of all tets: energy and gradient of Strain and Volume, fused and vectorised (SoftDECA Eq. 10).

E = Σ w/2 ‖F - p(F)‖² has the exact gradient Σ w (F - p) : ∂F/∂x, since p minimises the distance (but for the jumps of
Strain's indicator).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .lanes import (
    ACTIVE,
    COMPILED,
    D0,
    D1,
    D2,
    ENERGY,
    F00,
    F01,
    F02,
    F10,
    F11,
    F12,
    F20,
    F21,
    F22,
    G00,
    G01,
    G02,
    G10,
    G11,
    G12,
    G20,
    G21,
    G22,
    HIGH,
    LANES,
    LOW,
    PARAMETERS,
    ROWS,
    S0,
    S1,
    S2,
    STRAIN,
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
    VOLUME,
)
from .singular_values import decompose
from .volume_projection import project_volume, settle_doubts


@njit(**COMPILED)
def gather(w, parameters, corners, u):
    """Copy a block's parameters, and put the edges of the displacement u into F: row r, column j is u_j - u_0."""
    for i in range(PARAMETERS * LANES):
        w[i] = parameters[i]
    for k in range(LANES):
        a, b, c, d = corners[k], corners[LANES + k], corners[2 * LANES + k], corners[3 * LANES + k]
        w[F00 + k], w[F01 + k], w[F02 + k] = u[b, 0] - u[a, 0], u[c, 0] - u[a, 0], u[d, 0] - u[a, 0]
        w[F10 + k], w[F11 + k], w[F12 + k] = u[b, 1] - u[a, 1], u[c, 1] - u[a, 1], u[d, 1] - u[a, 1]
        w[F20 + k], w[F21 + k], w[F22 + k] = u[b, 2] - u[a, 2], u[c, 2] - u[a, 2], u[d, 2] - u[a, 2]


@njit(**COMPILED)
def deformation_gradient(w):
    """F = I + Du Dm_inv: from displacements, for differences of positions far from the origin lose digits."""
    for k in range(LANES):
        g00, g01, g02 = w[G00 + k], w[G01 + k], w[G02 + k]
        g10, g11, g12 = w[G10 + k], w[G11 + k], w[G12 + k]
        g20, g21, g22 = w[G20 + k], w[G21 + k], w[G22 + k]
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        w[F00 + k] = 1.0 + (a * g00 + b * g10 + c * g20)
        w[F01 + k], w[F02 + k] = a * g01 + b * g11 + c * g21, a * g02 + b * g12 + c * g22
        a, b, c = w[F10 + k], w[F11 + k], w[F12 + k]
        w[F11 + k] = 1.0 + (a * g01 + b * g11 + c * g21)
        w[F10 + k], w[F12 + k] = a * g00 + b * g10 + c * g20, a * g02 + b * g12 + c * g22
        a, b, c = w[F20 + k], w[F21 + k], w[F22 + k]
        w[F22 + k] = 1.0 + (a * g02 + b * g12 + c * g22)
        w[F20 + k], w[F21 + k] = a * g00 + b * g10 + c * g20, a * g01 + b * g11 + c * g21


@njit(**COMPILED)
def _is_slack(w):
    """Whether no lane's Strain acts, told by bounds of the stretches from F alone, without its decomposition.

    With I = |F|² and J = det F > 0: the largest stretch is at most √I, the smallest at least 2 J / I.
    """
    acting = 0
    for k in range(LANES):
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        d, e, f = w[F10 + k], w[F11 + k], w[F12 + k]
        g, h, i = w[F20 + k], w[F21 + k], w[F22 + k]
        squares = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
        j = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        high = w[HIGH + k]
        slack = squares <= high * high and 2.0 * j >= w[LOW + k] * squares
        acting += 0 if slack or w[STRAIN + k] == 0.0 else 1
    return acting == 0


@njit(**COMPILED)
def _add_strain(w):
    """Turn D, the volume's s - t, into the principal stresses of both terms; and their energy."""
    for k in range(LANES):
        low, high, volume = w[LOW + k], w[HIGH + k], w[VOLUME + k]
        s0, s1, s2 = w[S0 + k], w[S1 + k], w[S2 + k]
        strain = w[STRAIN + k] if s0 > w[ACTIVE + k] else 0.0
        a, b, c = s0 - min(max(s0, low), high), s1 - min(max(s1, low), high), s2 - min(max(s2, low), high)
        d, e, f = w[D0 + k], w[D1 + k], w[D2 + k]
        w[ENERGY + k] = 0.5 * (strain * (a * a + b * b + c * c) + volume * (d * d + e * e + f * f))
        w[D0 + k], w[D1 + k], w[D2 + k] = strain * a + volume * d, strain * b + volume * e, strain * c + volume * f


@njit(**COMPILED)
def _forces(w):
    """P = U diag(D) Vᵀ and the nodal derivatives P Dm_invᵀ, written to F: row r, column j belongs to vertex j."""
    for k in range(LANES):
        d0, d1, d2 = w[D0 + k], w[D1 + k], w[D2 + k]
        v00, v01, v02 = w[V00 + k] * d0, w[V01 + k] * d1, w[V02 + k] * d2
        v10, v11, v12 = w[V10 + k] * d0, w[V11 + k] * d1, w[V12 + k] * d2
        v20, v21, v22 = w[V20 + k] * d0, w[V21 + k] * d1, w[V22 + k] * d2
        g00, g01, g02 = w[G00 + k], w[G01 + k], w[G02 + k]
        g10, g11, g12 = w[G10 + k], w[G11 + k], w[G12 + k]
        g20, g21, g22 = w[G20 + k], w[G21 + k], w[G22 + k]
        a, b, c = w[U00 + k], w[U01 + k], w[U02 + k]
        p, q, r = a * v00 + b * v01 + c * v02, a * v10 + b * v11 + c * v12, a * v20 + b * v21 + c * v22
        w[F00 + k], w[F01 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F02 + k] = p * g20 + q * g21 + r * g22
        a, b, c = w[U10 + k], w[U11 + k], w[U12 + k]
        p, q, r = a * v00 + b * v01 + c * v02, a * v10 + b * v11 + c * v12, a * v20 + b * v21 + c * v22
        w[F10 + k], w[F11 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F12 + k] = p * g20 + q * g21 + r * g22
        a, b, c = w[U20 + k], w[U21 + k], w[U22 + k]
        p, q, r = a * v00 + b * v01 + c * v02, a * v10 + b * v11 + c * v12, a * v20 + b * v21 + c * v22
        w[F20 + k], w[F21 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F22 + k] = p * g20 + q * g21 + r * g22


@njit(**COMPILED)
def _scatter(w, corners, gradient):
    """Add a block's nodal derivatives to the gradient; vertex 0 of each tet gets minus their sum."""
    total = 0.0
    for k in range(LANES):
        total += w[ENERGY + k]
        a, b, c, d = corners[k], corners[LANES + k], corners[2 * LANES + k], corners[3 * LANES + k]
        for r in range(3):
            row = F00 + 3 * r * LANES + k
            p, q, s = w[row], w[row + LANES], w[row + 2 * LANES]
            gradient[a, r] -= p + q + s
            gradient[b, r] += p
            gradient[c, r] += q
            gradient[d, r] += s
    return total


@njit(nogil=True, **COMPILED)
def add_tets(parameters, corners, has_volume, u, gradient):
    """Add the tets' gradient [mN] at displacement u [mm], both (n, 3), in place; return their energy [µJ].

    parameters (blocks, PARAMETERS * LANES) and corners (blocks, 4 * LANES) are laid out as `lanes` says; has_volume
    (blocks,) tells where the volume projection is needed at all. Guards, which hardly ever act, cost a test of F.
    """
    w = np.zeros(ROWS * LANES)
    total = 0.0
    for block in range(len(parameters)):
        gather(w, parameters[block], corners[block], u)
        deformation_gradient(w)
        if not has_volume[block] and _is_slack(w):
            continue
        decompose(w)
        if not has_volume[block]:
            w[D0 : D0 + 3 * LANES] = 0.0
        elif project_volume(w) > 0:
            settle_doubts(w)
        _add_strain(w)
        _forces(w)
        total += _scatter(w, corners[block], gradient)
    return total
