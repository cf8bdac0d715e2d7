"""Isotropic functions of the deformation gradient through signed singular values F = U diag(s) Vᵀ.

U and V are rotations, s₁ ≥ s₂ ≥ |s₃|, and s₃ carries the sign of det F. Of psi(s) with gradient p and Hessian h,
P = U diag(p) Vᵀ; the tangent dP/dF has the 3x3 block h on the stretches, and per pair (i, j) a twist mode
(p_i + p_j)/(s_i + s_j) and a flip mode (p_i - p_j)/(s_i - s_j) (Smith, de Goes, Kim 2019, "Analytic Eigensystems for
Isotropic Distortion Energies", Section 4). The pairs are ordered (0, 1), (0, 2), (1, 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ...lhm.base.mesh import Floats

FIRST, SECOND = np.array([0, 0, 1]), np.array([1, 2, 2])
SMALLEST_SUM = 1e-9  # below it the rotation nearest to F is not unique, and the twist's curvature not finite
EQUAL = 1e-5  # relative distance of singular values below which the flip takes its limit; both errors are 1e-10


@dataclass(frozen=True, eq=False)
class Modes:
    """A tangent in the principal frame: block (m, 3, 3), twist and flip per pair (m, 3) [kPa]."""

    block: Floats
    twist: Floats
    flip: Floats

    def soften(self, kept: float) -> Modes:
        """The tangent with every negative eigenvalue multiplied by `kept`; at 0 the nearest semi-definite one."""
        block = np.array(self.block)
        indefinite = _indefinite(block)
        if indefinite.any():
            values, vectors = np.linalg.eigh(block[indefinite])
            values = np.maximum(values, kept * values)
            block[indefinite] = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
        return Modes(block, np.maximum(self.twist, kept * self.twist), np.maximum(self.flip, kept * self.flip))


def modes(s: Floats, p: Floats, h: Floats) -> Modes:
    """The tangent's modes from singular values (m, 3), and psi's gradient (m, 3) and Hessian (m, 3, 3) there [kPa]."""
    si, sj, pi, pj = s[:, FIRST], s[:, SECOND], p[:, FIRST], p[:, SECOND]
    total = si + sj
    twist = (pi + pj) / np.where(np.abs(total) < SMALLEST_SUM, SMALLEST_SUM, total)
    gap = si - sj
    equal = np.abs(gap) < EQUAL * np.maximum(1.0, np.abs(si))
    limit = 0.5 * (h[:, FIRST, FIRST] + h[:, SECOND, SECOND]) - h[:, FIRST, SECOND]
    flip = np.where(equal, limit, (pi - pj) / np.where(equal, 1.0, gap))
    return Modes(h, twist, flip)


@njit(cache=True)
def _indefinite(block):
    """Mask the symmetric blocks (m, 3, 3) that are not positive definite, by their leading minors."""
    indefinite = np.empty(len(block), dtype=np.bool_)
    for e in range(len(block)):
        a, b, c = block[e, 0, 0], block[e, 0, 1], block[e, 0, 2]
        d, f, g = block[e, 1, 1], block[e, 1, 2], block[e, 2, 2]
        det = a * (d * g - f * f) - b * (b * g - c * f) + c * (b * f - c * d)
        indefinite[e] = not (a > 0.0 and a * d - b * b > 0.0 and det > 0.0)
    return indefinite


@njit(cache=True)
def _orthogonalise(W, V):
    """One-sided Jacobi: turns W's columns orthogonal by rotations that V collects; small columns keep full accuracy."""
    for _ in range(40):
        turned = False
        for i, j in ((0, 1), (0, 2), (1, 2)):
            a = W[0, i] ** 2 + W[1, i] ** 2 + W[2, i] ** 2
            b = W[0, j] ** 2 + W[1, j] ** 2 + W[2, j] ** 2
            g = W[0, i] * W[0, j] + W[1, i] * W[1, j] + W[2, i] * W[2, j]
            if abs(g) <= 1e-16 * np.sqrt(a * b):
                continue
            turned = True
            zeta = (b - a) / (2.0 * g)
            t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
            c = 1.0 / np.sqrt(1.0 + t * t)
            for k in range(3):
                w, v = W[k, i], V[k, i]
                W[k, i], W[k, j] = c * (w - t * W[k, j]), c * (t * w + W[k, j])
                V[k, i], V[k, j] = c * (v - t * V[k, j]), c * (t * v + V[k, j])
        if not turned:
            return


@njit(cache=True)
def _sort(W, V, norms):
    """Order the columns by decreasing norm; an exchange turns one of the two round, so that V stays a rotation."""
    for i, j in ((0, 1), (1, 2), (0, 1)):
        if norms[i] < norms[j]:
            norms[i], norms[j] = norms[j], norms[i]
            for k in range(3):
                W[k, i], W[k, j] = W[k, j], -W[k, i]
                V[k, i], V[k, j] = V[k, j], -V[k, i]


@njit(cache=True)
def _complete(W, norms, U, s):
    """Rotation U and signed values s with W = U diag(s), for W's orthogonal columns in order of their norms."""
    tiny = 1e-300 + 1e-30 * norms[0]
    for k in range(3):
        U[k, 0] = W[k, 0] / norms[0] if norms[0] > tiny else (1.0 if k == 0 else 0.0)
    if norms[1] > tiny:
        for k in range(3):
            U[k, 1] = W[k, 1]
    else:
        axis = np.argmin(np.abs(U[:, 0]))
        for k in range(3):
            U[k, 1] = 1.0 if k == axis else 0.0
    dot = U[0, 0] * U[0, 1] + U[1, 0] * U[1, 1] + U[2, 0] * U[2, 1]
    for k in range(3):
        U[k, 1] -= dot * U[k, 0]
    length = np.sqrt(U[0, 1] ** 2 + U[1, 1] ** 2 + U[2, 1] ** 2)
    for k in range(3):
        U[k, 1] /= length
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        U[k, 2] = U[a, 0] * U[b, 1] - U[b, 0] * U[a, 1]
    s[0] = norms[0]
    s[1] = norms[1]
    s[2] = W[0, 2] * U[0, 2] + W[1, 2] * U[1, 2] + W[2, 2] * U[2, 2]


@njit(cache=True)
def signed_svd(F: Floats):
    """U (m, 3, 3), s (m, 3), V (m, 3, 3) of matrices F (m, 3, 3): F = U diag(s) Vᵀ with rotations U and V."""
    m = len(F)
    U, s, V = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
    W, norms = np.empty((3, 3)), np.empty(3)
    for e in range(m):
        for i in range(3):
            for j in range(3):
                W[i, j] = F[e, i, j]
                V[e, i, j] = 1.0 if i == j else 0.0
        _orthogonalise(W, V[e])
        for j in range(3):
            norms[j] = np.sqrt(W[0, j] ** 2 + W[1, j] ** 2 + W[2, j] ** 2)
        _sort(W, V[e], norms)
        _complete(W, norms, U[e], s[e])
    return U, s, V


@njit(cache=True)
def stress(U: Floats, V: Floats, p: Floats):
    """P = U diag(p) Vᵀ [kPa], shape (m, 3, 3)."""
    P = np.empty(U.shape)
    for e in range(len(U)):
        for i in range(3):
            for j in range(3):
                P[e, i, j] = (
                    p[e, 0] * U[e, i, 0] * V[e, j, 0]
                    + p[e, 1] * U[e, i, 1] * V[e, j, 1]
                    + p[e, 2] * U[e, i, 2] * V[e, j, 2]
                )
    return P
