"""The local step: energy and gradient of Strain and Volume on tets, a block of LANES tets at a time.

The stress is P = R f(S), with F = R S and f the sum of the terms' principal stresses. A Strain of limit 1 needs R
alone: w (F - R). For the others f is the quadratic in S that meets the principal stresses at the three stretches
(Newton's divided differences), which needs no singular vectors. Volume's principal stress is d_i = s_i - t_i = -m/t_i
(`volumes`), whose differences are d[i, j] = m/(t_i t_j + m), where nothing cancels however near two stretches are.
Blocks with a tet so flat that R is not sure, or at a kink of its stress, go by singular values.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# isort: off
from .lanes import (
    A0,
    A1,
    A2,
    ALWAYS_READ,
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
    FIRST,
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
    HIGH2,
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
    LOW,
    LOW2,
    MULTIPLIER,
    PARAMETERS,
    R00,
    R01,
    R02,
    R10,
    R11,
    R12,
    R20,
    R21,
    R22,
    ROWS,
    S0,
    S1,
    S2,
    SECOND,
    STRAIN,
    STRAIN2,
    U00,
    V00,
    VOLUME,
)  # fmt: skip

# isort: on
from .polar import nearest_rotation, stretches
from .singular import decompose
from .volumes import project_volume

HAS_VOLUME, HAS_BOUNDS, HAS_GUARDS = 1, 2, 4
"""What a block asks for: a volume, a first Strain that is not of limit 1, a second Strain."""
NEAR = 1e-8
"""Where two stretches differ by less, a difference quotient is taken for the derivative."""
CLOSE = 1e-5
"""Stretches that are nearer to one another and to a bound are not exact enough by invariants."""
ALIKE = 1e-3
"""Share of t_i t_j below which t_i t_j + m is lost in rounding."""


@njit(**COMPILED)
def _read_bounds(w, parameters):
    """Copy the parameters of a block that not every block needs."""
    for i in range(ALWAYS_READ * LANES, PARAMETERS * LANES):
        w[i] = parameters[i]


@njit(**COMPILED)
def gather(w, parameters, corners, kinds, u):
    """Copy a block's parameters, and compute F = I + Du Dm_inv of the displacement u.

    Guards' parameters are left out. From displacements, for differences of positions far from the origin lose digits.
    """
    for i in range(ALWAYS_READ * LANES):
        w[i] = parameters[i]
    if kinds & HAS_BOUNDS:
        _read_bounds(w, parameters)
    for k in range(LANES):
        a, b, c, d = corners[k], corners[LANES + k], corners[2 * LANES + k], corners[3 * LANES + k]
        w[F00 + k], w[F01 + k], w[F02 + k] = u[b, 0] - u[a, 0], u[c, 0] - u[a, 0], u[d, 0] - u[a, 0]
        w[F10 + k], w[F11 + k], w[F12 + k] = u[b, 1] - u[a, 1], u[c, 1] - u[a, 1], u[d, 1] - u[a, 1]
        w[F20 + k], w[F21 + k], w[F22 + k] = u[b, 2] - u[a, 2], u[c, 2] - u[a, 2], u[d, 2] - u[a, 2]
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
def _forces(w):
    """Write the nodal derivatives P Dm_invᵀ to F: row r, column j belongs to vertex j; and add limit 1's energy."""
    for k in range(LANES):
        strain, size = w[STRAIN + k], w[LOW + k]
        quadratic = w[A2 + k]
        turned = w[A0 + k] - quadratic * w[SECOND + k]
        linear = w[A1 + k] + quadratic * w[FIRST + k]
        g00, g01, g02 = w[G00 + k], w[G01 + k], w[G02 + k]
        g10, g11, g12 = w[G10 + k], w[G11 + k], w[G12 + k]
        g20, g21, g22 = w[G20 + k], w[G21 + k], w[G22 + k]
        f0, f1, f2 = w[F00 + k], w[F01 + k], w[F02 + k]
        r0, r1, r2 = w[R00 + k], w[R01 + k], w[R02 + k]
        a, b, c = f0 - size * r0, f1 - size * r1, f2 - size * r2
        squares = a * a + b * b + c * c
        p = strain * a + turned * r0 + linear * f0 + quadratic * w[K00 + k]
        q = strain * b + turned * r1 + linear * f1 + quadratic * w[K01 + k]
        r = strain * c + turned * r2 + linear * f2 + quadratic * w[K02 + k]
        w[F00 + k], w[F01 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F02 + k] = p * g20 + q * g21 + r * g22
        f0, f1, f2 = w[F10 + k], w[F11 + k], w[F12 + k]
        r0, r1, r2 = w[R10 + k], w[R11 + k], w[R12 + k]
        a, b, c = f0 - size * r0, f1 - size * r1, f2 - size * r2
        squares += a * a + b * b + c * c
        p = strain * a + turned * r0 + linear * f0 + quadratic * w[K10 + k]
        q = strain * b + turned * r1 + linear * f1 + quadratic * w[K11 + k]
        r = strain * c + turned * r2 + linear * f2 + quadratic * w[K12 + k]
        w[F10 + k], w[F11 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F12 + k] = p * g20 + q * g21 + r * g22
        f0, f1, f2 = w[F20 + k], w[F21 + k], w[F22 + k]
        r0, r1, r2 = w[R20 + k], w[R21 + k], w[R22 + k]
        a, b, c = f0 - size * r0, f1 - size * r1, f2 - size * r2
        squares += a * a + b * b + c * c
        p = strain * a + turned * r0 + linear * f0 + quadratic * w[K20 + k]
        q = strain * b + turned * r1 + linear * f1 + quadratic * w[K21 + k]
        r = strain * c + turned * r2 + linear * f2 + quadratic * w[K22 + k]
        w[F20 + k], w[F21 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F22 + k] = p * g20 + q * g21 + r * g22
        w[ENERGY + k] += 0.5 * strain * squares


@njit(**COMPILED)
def _forces_by_frames(w):
    """Write the nodal derivatives of P = U diag(D) Vᵀ to F as `_forces` does, and the energy, by singular vectors."""
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
        for r in range(3):
            for j in range(3):
                total = 0.0
                for i in range(3):
                    along = 0.0
                    for c in range(3):
                        along += w[V00 + (3 * c + i) * LANES + k] * w[G00 + (3 * j + c) * LANES + k]
                    total += w[U00 + (3 * r + i) * LANES + k] * p[i] * along
                w[F00 + (3 * r + j) * LANES + k] = total


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


@njit(**COMPILED)
def singular_stretches(w, parameters, kinds):
    """Write U, s and V of a block, and s - t to D, which is 0 where the block has no Volume."""
    _read_bounds(w, parameters)
    decompose(w)
    w[D0 : D0 + 3 * LANES] = 0.0
    if kinds & HAS_VOLUME:
        project_volume(w)


@njit(nogil=True, **COMPILED)
def add_tets(parameters, corners, kinds, u, gradient):
    """Add the tets' gradient [mN] at displacement u [mm], both (n, 3), in place; return their energy [µJ].

    parameters (blocks, PARAMETERS * LANES) and corners (blocks, 4 * LANES) have the layout of `lanes`; kinds (blocks,)
    tells what each block asks for. Guards, which hardly ever act, cost a look at the stretches.
    """
    w = np.zeros(ROWS * LANES)
    total = 0.0
    for block in range(len(parameters)):
        kind = kinds[block]
        gather(w, parameters[block], corners[block], kind, u)
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
            _forces_by_frames(w)
        else:
            if kind & HAS_BOUNDS:
                _bounded_stress(w, STRAIN, LOW, HIGH)
                w[STRAIN : STRAIN + LANES] = 0.0
            if guarded and _acts(w, STRAIN2, LOW2, HIGH2):
                _bounded_stress(w, STRAIN2, LOW2, HIGH2)
            _forces(w)
        total += _scatter(w, corners[block], gradient)
    return total
