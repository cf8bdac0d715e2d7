"""The exact Hessian of SurfaceStrain, triangle after triangle, in the frame of F's singular values s0 >= s1 >= 0.

E = w/2 Σ (s_i - r)². Stretches have the eigenvalue w; the pair in the plane the flip w and the twist
w (1 - 2 r/(s0 + s1)); out of the plane there is w (1 - r/s_i) for each, negative where the skin is compressed.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from .lanes import COMPILED
from .tet_tangent import add_block
from .triangles import FLOOR

PAIRS = np.array([[a, b] for a in range(3) for b in range(a, 3)])
"""The pairs of a triangle's corners, one block of the Hessian each."""


@njit(**COMPILED)
def _frame(f, U, V):
    """Singular values of f (3, 2), with U (3, 3) and V (2, 2) its frames; a flat f gets any normal."""
    a = f[0, 0] ** 2 + f[1, 0] ** 2 + f[2, 0] ** 2
    b = f[0, 1] ** 2 + f[1, 1] ** 2 + f[2, 1] ** 2
    g = f[0, 0] * f[0, 1] + f[1, 0] * f[1, 1] + f[2, 0] * f[2, 1]
    angle = 0.5 * np.arctan2(2.0 * g, a - b)
    c, s = np.cos(angle), np.sin(angle)
    V[0, 0], V[1, 0], V[0, 1], V[1, 1] = c, s, -s, c
    for r in range(3):
        U[r, 0], U[r, 1] = f[r, 0] * c + f[r, 1] * s, f[r, 1] * c - f[r, 0] * s
    s0 = sqrt(U[0, 0] ** 2 + U[1, 0] ** 2 + U[2, 0] ** 2)
    s0 = max(s0, 1e-150)
    for r in range(3):
        U[r, 0] /= s0
    along = U[0, 0] * U[0, 1] + U[1, 0] * U[1, 1] + U[2, 0] * U[2, 1]
    for r in range(3):
        U[r, 1] -= along * U[r, 0]
    s1 = sqrt(U[0, 1] ** 2 + U[1, 1] ** 2 + U[2, 1] ** 2)
    if s1 > 1e-14 * s0:
        for r in range(3):
            U[r, 1] /= s1
    else:
        axis = 0 if abs(U[0, 0]) < 0.9 else 1
        along = U[axis, 0]
        for r in range(3):
            U[r, 1] = (1.0 if r == axis else 0.0) - along * U[r, 0]
        norm = sqrt(U[0, 1] ** 2 + U[1, 1] ** 2 + U[2, 1] ** 2)
        for r in range(3):
            U[r, 1] /= norm
    U[0, 2] = U[1, 0] * U[2, 1] - U[2, 0] * U[1, 1]
    U[1, 2] = U[2, 0] * U[0, 1] - U[0, 0] * U[2, 1]
    U[2, 2] = U[0, 0] * U[1, 1] - U[1, 0] * U[0, 1]
    return s0, max(s1, sqrt(FLOOR) / s0)


@njit(**COMPILED)
def add_triangle_tangent(corners, inverse, weight, scale, edges, slots, least, u, blocks):
    """Add the triangles' Hessian [mN/mm] at displacement u [mm], shape (n, 3), to blocks (pairs, 3, 3), in place.

    slots (triangles, 6) are the blocks of `PAIRS`; `least` is the share of the weight below which no eigenvalue is
    left, if it is not negative.
    """
    f, U, V, g = np.empty((3, 2)), np.empty((3, 3)), np.empty((2, 2)), np.empty((3, 2))
    M, block = np.empty((3, 3)), np.empty((3, 3))
    for t in range(len(corners)):
        a, b, c = corners[t]
        for r in range(3):
            p0, p1 = edges[t, r, 0] + u[b, r] - u[a, r], edges[t, r, 1] + u[c, r] - u[a, r]
            f[r, 0] = p0 * inverse[t, 0, 0] + p1 * inverse[t, 1, 0]
            f[r, 1] = p0 * inverse[t, 0, 1] + p1 * inverse[t, 1, 1]
        s0, s1 = _frame(f, U, V)
        w, growth = weight[t], scale[t]
        twist, out0, out1 = 1.0 - 2.0 * growth / (s0 + s1), 1.0 - growth / s0, 1.0 - growth / s1
        if least >= 0.0:
            twist, out0, out1 = max(twist, least), max(out0, least), max(out1, least)
        alpha, beta = 0.5 * w * (1.0 + twist), 0.5 * w * (1.0 - twist)
        out0, out1 = w * out0, w * out1
        for i in range(2):
            for j in range(2):
                g[i + 1, j] = V[0, j] * inverse[t, i, 0] + V[1, j] * inverse[t, i, 1]
        for j in range(2):
            g[0, j] = -(g[1, j] + g[2, j])
        number = 0
        for i in range(3):
            for j in range(i, 3):
                M[:] = 0.0
                M[0, 0] = w * g[i, 0] * g[j, 0] + alpha * g[i, 1] * g[j, 1]
                M[1, 1] = w * g[i, 1] * g[j, 1] + alpha * g[i, 0] * g[j, 0]
                M[0, 1], M[1, 0] = beta * g[i, 1] * g[j, 0], beta * g[i, 0] * g[j, 1]
                M[2, 2] = out0 * g[i, 0] * g[j, 0] + out1 * g[i, 1] * g[j, 1]
                for r in range(3):
                    w0 = U[r, 0] * M[0, 0] + U[r, 1] * M[1, 0]
                    w1 = U[r, 0] * M[0, 1] + U[r, 1] * M[1, 1]
                    w2 = U[r, 2] * M[2, 2]
                    for k in range(3):
                        block[r, k] = w0 * U[k, 0] + w1 * U[k, 1] + w2 * U[k, 2]
                add_block(blocks, slots[t, number], block, corners[t, i] < corners[t, j])
                number += 1
