"""The exact Hessian of Bending, ring after ring, in the frame of S = U diag(s) Vᵀ.

There E = k/(2A) |y - R B|² with y = Σ w e, and R = 1. Along dS = e_i e_jᵀ, R turns by W = κ (e_i e_jᵀ - e_j e_iᵀ),
κ = 1/(s_i + s_j), and Y = RᵀS changes by the symmetric Y' = dS - W Y; along two such, p and q, R changes by
(W_p W_q + W_q W_p)/2 + W_pq, where W_pq Y + Y W_pq = - [(W_p W_q + W_q W_p)/2, Y] - {W_p, Y'_q} - {W_q, Y'_p}.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .bending import gather
from .lanes import COMPILED, D0, LANES, ROWS, S0, U00, V00
from .singular_values import decompose
from .tet_tangent import add_block


@njit(**COMPILED)
def _second(s, least, y, B, H):
    """Write the Hessian H (12, 12) of |y - R B|²/2 over y and S, numbered 4 r + 0 for y_r and 4 r + 1 + c for S_rc."""
    sums = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            sums[i, j] = max(s[i] + s[j], least)
    W, Y = np.zeros((9, 3, 3)), np.zeros((9, 3, 3))
    H[:] = 0.0
    for i in range(3):
        H[4 * i, 4 * i] = 1.0
        for j in range(3):
            p, at = 3 * i + j, 4 * i + 1 + j
            if i == j:
                Y[p, i, i] = 1.0
                continue
            kappa = 1.0 / sums[i, j]
            W[p, i, j], W[p, j, i] = kappa, -kappa
            Y[p, i, j] = Y[p, j, i] = kappa * s[i]
            H[4 * i, at] -= kappa * B[j]
            H[4 * j, at] += kappa * B[i]
            H[at, 4 * i], H[at, 4 * j] = H[4 * i, at], H[4 * j, at]
    for p in range(9):
        for q in range(p, 9):
            value = 0.0
            for i in range(3):
                for j in range(3):
                    both, mixed = 0.0, 0.0
                    for r in range(3):
                        both += 0.5 * (W[p, i, r] * W[q, r, j] + W[q, i, r] * W[p, r, j])
                        mixed += W[p, i, r] * Y[q, r, j] + Y[q, i, r] * W[p, r, j]
                        mixed += W[q, i, r] * Y[p, r, j] + Y[p, i, r] * W[q, r, j]
                    value += y[i] * B[j] * (both - (both * (s[j] - s[i]) + mixed) / sums[i, j])
            a, b = 4 * (p // 3) + 1 + p % 3, 4 * (q // 3) + 1 + q % 3
            H[a, b] = H[b, a] = -value


@njit(**COMPILED)
def _ring(H, U, v, K):
    """Write the blocks K (m, m, 3, 3) between a ring's vertices whose parts in (y, S) are v (m, 4)."""
    M, half = np.empty((3, 3)), np.empty((12, 3))
    for b in range(len(v)):
        for at in range(12):
            for t in range(3):
                total = 0.0
                for beta in range(4):
                    total += H[at, 4 * t + beta] * v[b, beta]
                half[at, t] = total
        for a in range(len(v)):
            for r in range(3):
                for t in range(3):
                    total = 0.0
                    for alpha in range(4):
                        total += v[a, alpha] * half[4 * r + alpha, t]
                    M[r, t] = total
            K[a, b] = U @ M @ U.T


@njit(**COMPILED)
def add_bending_tangent(
    centres, starts, ring, cotangents, edges, sought, laplacians, least, weights, slots, first, u, blocks
):
    """Add the rings' Hessian [mN/mm] at displacement u [mm], shape (n, 3), to blocks (pairs, 3, 3), in place.

    slots from first[v] on are the blocks of ring v: of its vertices, the centre before the ring, each with itself and
    those after it.
    """
    w = np.zeros(ROWS * LANES)
    U, V, s, y, B, H = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty((12, 12))
    for begin in range(0, len(centres), LANES):
        end = min(begin + LANES, len(centres))
        gather(w, centres[begin:end], starts[begin : end + 1], ring, cotangents, edges, sought, u)
        decompose(w)
        for i in range(begin, end):
            k = i - begin
            for r in range(3):
                s[r] = w[S0 + r * LANES + k]
                for c in range(3):
                    U[r, c], V[r, c] = w[U00 + (3 * r + c) * LANES + k], w[V00 + (3 * r + c) * LANES + k]
            y[:], B[:] = 0.0, 0.0
            for r in range(3):
                for c in range(3):
                    y[c] += U[r, c] * w[D0 + r * LANES + k]
                    B[c] += V[r, c] * laplacians[i, r]
            _second(s, least[i], y, B, H)
            m = starts[i + 1] - starts[i] + 1
            v = np.zeros((m, 4))
            for a in range(1, m):
                at = starts[i] + a - 1
                v[a, 0] = cotangents[at]
                for c in range(3):
                    for r in range(3):
                        v[a, 1 + c] += max(cotangents[at], 0.0) * V[r, c] * sought[at, r]
                v[0] -= v[a]
            K = np.empty((m, m, 3, 3))
            _ring(weights[i] * H, U, v, K)
            at = first[i]
            for a in range(m):
                here = centres[i] if a == 0 else ring[starts[i] + a - 1]
                for b in range(a, m):
                    there = centres[i] if b == 0 else ring[starts[i] + b - 1]
                    add_block(blocks, slots[at], K[a, b], here < there)
                    at += 1


@njit(**COMPILED)
def add_bending_bound(starts, cotangents, weights, slots, first, blocks):
    """Add Σ k/A l lᵀ, l the Laplacian's rows: the Hessian with R held, which has no negative eigenvalue."""
    for i in range(len(weights)):
        m = starts[i + 1] - starts[i] + 1
        total = 0.0
        for at in range(starts[i], starts[i + 1]):
            total += cotangents[at]
        slot = first[i]
        for a in range(m):
            la = -total if a == 0 else cotangents[starts[i] + a - 1]
            for b in range(a, m):
                lb = -total if b == 0 else cotangents[starts[i] + b - 1]
                for r in range(3):
                    blocks[slots[slot], r, r] += weights[i] * la * lb
                slot += 1
