"""The exact Hessian of Strain and Volume on cells, or with its eigenvalues raised.

With F = U diag(s) Vᵀ and principal stresses p, dP/dF has a 3x3 block on the stretches and, per pair (i, j), a twist
(p_i + p_j)/(s_i + s_j) and a flip (p_i - p_j)/(s_i - s_j) (Smith, de Goes, Kim 2019, "Analytic Eigensystems for
Isotropic Distortion Energies", Section 4). Volume's nearest stretches have t_i (t_i - s_i) = m, so
with q_i = 1/(t_i² + m) its block, flip and twist are rational in t and m and nothing cancels where stretches are equal.
Pairs are ordered (0, 1), (0, 2), (1, 2); pairs of a cell's corners as `corner_pairs`.
"""

from __future__ import annotations

import numpy as np

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Ints
from ..unknowns.sparsity import add_block
from .local_step import (
    COMPILED,
    D0,
    D1,
    D2,
    GRADIENTS,
    HIGH,
    HIGH2,
    LANES,
    LOW,
    LOW2,
    MODES,
    ROWS,
    S0,
    S1,
    S2,
    STRAIN,
    STRAIN2,
    U00,
    V00,
    VOLUME,
    gather,
    singular_stretches,
)

SMALLEST = 1e-9
"""Where s_i + s_j is less, the nearest rotation is not unique and the twist not finite: it is held there."""


@njit(inline="always", **COMPILED)
def _away(value):
    """Keep a divisor away from zero."""
    return value if abs(value) > SMALLEST else (SMALLEST if value >= 0.0 else -SMALLEST)


@njit(inline="always", **COMPILED)
def _strain_pair(a, b, ca, cb, inside_a, inside_b):
    """Return twist and flip of unit Strain for stretches a >= b with distances ca, cb from their bounds."""
    if a - b > 1e-8:
        flip = (ca - cb) / (a - b)
    else:
        flip = 0.0 if inside_a and inside_b else 1.0
    return (ca + cb) / _away(a + b), flip


@njit(**COMPILED)
def _add_strain(w, k, weight, bottom, top, h, twist, flip):
    """Add one lane's Strain, whose rows these are, to the block h (3, 3), twist (3,) and flip (3,)."""
    s0, s1, s2 = w[S0 + k], w[S1 + k], w[S2 + k]
    strain, low, high = w[weight + k], w[bottom + k], w[top + k]
    if strain == 0.0:
        return
    c0, c1, c2 = s0 - min(max(s0, low), high), s1 - min(max(s1, low), high), s2 - min(max(s2, low), high)
    in0, in1, in2 = low < s0 < high, low < s1 < high, low < s2 < high
    h[0, 0] += 0.0 if in0 else strain
    h[1, 1] += 0.0 if in1 else strain
    h[2, 2] += 0.0 if in2 else strain
    turned, exchanged = _strain_pair(s0, s1, c0, c1, in0, in1)
    twist[0], flip[0] = twist[0] + strain * turned, flip[0] + strain * exchanged
    turned, exchanged = _strain_pair(s0, s2, c0, c2, in0, in2)
    twist[1], flip[1] = twist[1] + strain * turned, flip[1] + strain * exchanged
    turned, exchanged = _strain_pair(s1, s2, c1, c2, in1, in2)
    twist[2], flip[2] = twist[2] + strain * turned, flip[2] + strain * exchanged


@njit(**COMPILED)
def _moduli(w, k, h, twist, flip):
    """Write the block h (3, 3), twist (3,) and flip (3,) of one lane, weights and rest volume included."""
    s0, s1, s2, volume = w[S0 + k], w[S1 + k], w[S2 + k], w[VOLUME + k]
    h[:], twist[:], flip[:] = 0.0, 0.0, 0.0
    _add_strain(w, k, STRAIN, LOW, HIGH, h, twist, flip)
    _add_strain(w, k, STRAIN2, LOW2, HIGH2, h, twist, flip)
    if volume == 0.0:
        return
    t0, t1, t2 = s0 - w[D0 + k], s1 - w[D1 + k], s2 - w[D2 + k]
    m = -t0 * w[D0 + k]
    q0, q1, q2 = 1.0 / _away(t0 * t0 + m), 1.0 / _away(t1 * t1 + m), 1.0 / _away(t2 * t2 + m)
    scale = volume / (q0 + q1 + q2)
    h[0, 0] += scale * q0 * (1.0 + m * (q1 + q2))
    h[1, 1] += scale * q1 * (1.0 + m * (q0 + q2))
    h[2, 2] += scale * q2 * (1.0 + m * (q0 + q1))
    h[0, 1] = h[1, 0] = scale * t0 * t1 * q0 * q1
    h[0, 2] = h[2, 0] = scale * t0 * t2 * q0 * q2
    h[1, 2] = h[2, 1] = scale * t1 * t2 * q1 * q2
    twist[0] -= volume * m / _away(t0 * t1 - m)
    twist[1] -= volume * m / _away(t0 * t2 - m)
    twist[2] -= volume * m / _away(t1 * t2 - m)
    flip[0] += volume * m / _away(t0 * t1 + m)
    flip[1] += volume * m / _away(t0 * t2 + m)
    flip[2] += volume * m / _away(t1 * t2 + m)


@njit(**COMPILED)
def _raise_block(h, least):
    """Raise the eigenvalues of a symmetric h (n, n) to at least `least`, in place (cyclic Jacobi)."""
    n = len(h)
    V = np.eye(n)
    for _ in range(30):
        off, size = 0.0, 0.0
        for i in range(n):
            size += h[i, i] ** 2
            for j in range(i):
                off += h[i, j] ** 2
        if off <= 1e-28 * size:
            break
        for i in range(n - 1):
            for j in range(i + 1, n):
                if h[i, j] == 0.0:
                    continue
                zeta = (h[j, j] - h[i, i]) / (2.0 * h[i, j])
                t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for r in range(n):
                    x, y = h[r, i], h[r, j]
                    h[r, i], h[r, j] = c * x - s * y, s * x + c * y
                for r in range(n):
                    x, y = h[i, r], h[j, r]
                    h[i, r], h[j, r] = c * x - s * y, s * x + c * y
                for r in range(n):
                    x, y = V[r, i], V[r, j]
                    V[r, i], V[r, j] = c * x - s * y, s * x + c * y
    values = np.empty(n)
    for i in range(n):
        values[i] = max(h[i, i], least)
    for r in range(n):
        for c2 in range(n):
            total = 0.0
            for i in range(n):
                total += V[r, i] * values[i] * V[c2, i]
            h[r, c2] = total


@njit(**COMPILED)
def _raise(h, twist, flip, least):
    """Raise all nine eigenvalues to at least `least`."""
    for pair in range(3):
        twist[pair], flip[pair] = max(twist[pair], least), max(flip[pair], least)
    a, b, c = h[0, 0] - least, h[0, 1], h[0, 2]
    d, f, g = h[1, 1] - least, h[1, 2], h[2, 2] - least
    det = a * (d * g - f * f) - b * (b * g - c * f) + c * (b * f - c * d)
    if not (a > 0.0 and a * d - b * b > 0.0 and det > 0.0):
        _raise_block(h, least)


@njit(**COMPILED)
def _pair_block(h, alpha, beta, ga, gb, U, block, work):
    """Compute U M Uᵀ with M the Hessian between two corners whose shape gradients are ga, gb in the frame of V."""
    for i in range(3):
        for k in range(3):
            if i == k:
                value = h[i, i] * ga[i] * gb[i]
                for j in range(3):
                    if j != i:
                        value += alpha[i + j - 1] * ga[j] * gb[j]
            else:
                value = h[i, k] * ga[i] * gb[k] + beta[i + k - 1] * ga[k] * gb[i]
            work[i, k] = value
    for r in range(3):
        w0 = U[r, 0] * work[0, 0] + U[r, 1] * work[1, 0] + U[r, 2] * work[2, 0]
        w1 = U[r, 0] * work[0, 1] + U[r, 1] * work[1, 1] + U[r, 2] * work[2, 1]
        w2 = U[r, 0] * work[0, 2] + U[r, 1] * work[1, 2] + U[r, 2] * work[2, 2]
        for c in range(3):
            block[r, c] = w0 * U[c, 0] + w1 * U[c, 1] + w2 * U[c, 2]


def corner_pairs(corners: int) -> Ints:
    """Return the pairs (k, 2) of a cell's corners, one block of the Hessian each."""
    return np.column_stack(np.triu_indices(corners))


@njit(**COMPILED)
def add_cell_tangent(parameters, corners, edges, kinds, slots, least, u, blocks):
    """Add the cells' Hessian [mN/mm] at displacement u [mm], shape (n, 3), to blocks (pairs, 3, 3), in place.

    slots (cells, k) are the blocks of `corner_pairs`, of which each holds rows of its higher vertex. Where `least` is
    not negative, no eigenvalue of dP/dF is left below that share of the cell's Strain weight. edges: see `local_step`.
    """
    w = np.zeros(ROWS * LANES)
    h, twist, flip, alpha, beta = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    ends = len(edges)
    U, g, work = np.empty((3, 3)), np.empty((ends, 3)), np.empty((3, 3))
    K = np.empty((ends, ends, 3, 3))
    first = np.empty((3, 3))
    for block in range(len(parameters)):
        gather(w, parameters[block], corners[block], edges, kinds[block], u)
        singular_stretches(w, parameters[block], kinds[block])
        for k in range(min(LANES, len(slots) - block * LANES)):
            _moduli(w, k, h, twist, flip)
            if least >= 0.0:
                _raise(h, twist, flip, least * (w[STRAIN + k] + w[STRAIN2 + k]))
            # Pairs in the order 01, 02, 12: i + j - 1 is their number.
            for pair in range(3):
                alpha[pair], beta[pair] = 0.5 * (flip[pair] + twist[pair]), 0.5 * (flip[pair] - twist[pair])
            for j in range(3):
                for i in range(3):
                    U[i, j] = w[U00 + (3 * i + j) * LANES + k]
                for i in range(ends):
                    total = 0.0
                    for r in range(3):
                        total += w[V00 + (3 * r + j) * LANES + k] * w[GRADIENTS + (3 * i + r) * LANES + k]
                    g[i, j] = total
            for a in range(ends):
                for b in range(a, ends):
                    _pair_block(h, alpha, beta, g[a], g[b], U, K[a, b], work)
                    for mode in range(ends - 3):
                        one, other = MODES + ((ends - 3) * a + mode) * LANES, MODES + ((ends - 3) * b + mode) * LANES
                        for r in range(3):
                            K[a, b, r, r] += w[one + k] * w[other + k]
                    if a != b:
                        K[b, a] = K[a, b].T
            # Slots in the order of `corner_pairs`: first those of the first corner, then of each edge's end.
            t, slot = block * LANES + k, ends + 1
            for a in range(ends):
                here = corners[block, (a + 1) * LANES + k]
                for b in range(a, ends):
                    add_block(blocks, slots[t, slot], K[a, b], here < corners[block, (b + 1) * LANES + k])
                    slot += 1
            # Shape gradients add up to nothing, so a corner's row is minus the sum of the others'.
            origin = corners[block, k]
            work[:] = 0.0
            for b in range(ends):
                first[:] = 0.0
                for a in range(ends):
                    first -= K[a, b]
                add_block(blocks, slots[t, b + 1], first, origin < corners[block, (b + 1) * LANES + k])
                work -= first
            add_block(blocks, slots[t, 0], work, False)
