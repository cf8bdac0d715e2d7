"""Nearest matrices to F in a set of stretches, and how they move with F.

Both sets of SoftDECA Eq. 10 depend on the singular values alone, so the nearest matrix to F = U diag(sigma) Vᵀ is
U diag(s) Vᵀ with s the nearest stretches to sigma. The SVD is signed (U and V rotations; the sign of det F on the
smallest singular value), so that an inverted tet is led back the short way.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats

SMALL = 1e-9
TINY = 1e-300
ROOT_ITERATIONS = 80


def signed_svd(F: Floats) -> tuple[Floats, Floats, Floats]:
    """U, sigma (m, 3) and Vᵀ with F = U diag(sigma) Vᵀ, det U = det V = 1 and sigma_1 >= sigma_2 >= |sigma_3|."""
    U, sigma, Vt = np.linalg.svd(F)
    sign_U, sign_V = np.sign(np.linalg.det(U)), np.sign(np.linalg.det(Vt))
    U[:, :, 2] *= sign_U[:, None]
    Vt[:, 2, :] *= sign_V[:, None]
    sigma[:, 2] *= sign_U * sign_V
    return U, sigma, Vt


def clamp_stretches(sigma: Floats, limit: Floats) -> tuple[Floats, Floats]:
    """The nearest stretches in [1/limit, limit], shape (m, 3), and their Jacobian by sigma, shape (m, 3, 3)."""
    low, high = 1 / limit[:, None], limit[:, None]
    slope = np.eye(3) * ((sigma > low) & (sigma < high))[:, None, :]
    return np.clip(sigma, low, high), slope


def nearest_of_determinant(sigma: Floats, target: Floats) -> tuple[Floats, Floats]:
    """The nearest stretches with product `target`, shape (m, 3), and their Jacobian by sigma, shape (m, 3, 3).

    Stationarity of |s - sigma|²/2 - c ln(s_1 s_2 s_3 / target) reads s_i (s_i - sigma_i) = c for every i. The two
    larger s_i are the larger roots; the smallest one parametrises the curve: c = s_3 (s_3 - sigma_3). What is left is
    one equation for s_3. It has one root where the product is to grow, and may have several where it is to shrink.
    """
    grow = np.prod(sigma, axis=1) <= target
    grow |= sigma[:, 2] <= 0
    edge = np.maximum(sigma[:, 2], 0)
    s3 = np.empty(len(sigma))
    s3[grow] = _root(sigma[grow], target[grow], edge[grow], edge[grow] + np.cbrt(target[grow]))
    s3[~grow] = _nearest_root(sigma[~grow], target[~grow])
    s = _on_curve(sigma, s3)
    return s, _slope(sigma, s)


def projection_derivative(U: Floats, sigma: Floats, Vt: Floats, nearest: Floats, slope: Floats) -> Floats:
    """The derivative by F of U diag(nearest(sigma)) Vᵀ, shape (m, 3, 3, 3, 3).

    In the frame of U and V the diagonal moves by `slope`; of each off-diagonal pair, the symmetric part is scaled by
    (s_i - s_j)/(sigma_i - sigma_j) and the antisymmetric part, a rotation, by (s_i + s_j)/(sigma_i + sigma_j).
    """
    D = np.zeros((len(sigma), 3, 3, 3, 3))
    for i in range(3):
        for j in range(3):
            D[:, i, i, j, j] = slope[:, i, j]
    for i, j in ((0, 1), (1, 2), (0, 2)):
        gap = sigma[:, i] - sigma[:, j]
        near = gap < SMALL * (1 + sigma[:, 0])
        # Where two stretches meet, the quotient becomes the derivative along their difference.
        limit = (slope[:, i, i] - slope[:, i, j] - slope[:, j, i] + slope[:, j, j]) / 2
        symmetric = np.where(near, limit, (nearest[:, i] - nearest[:, j]) / np.where(near, 1, gap))
        rotation = (nearest[:, i] + nearest[:, j]) / np.maximum(sigma[:, i] + sigma[:, j], SMALL)
        D[:, i, j, i, j] = D[:, j, i, j, i] = (symmetric + rotation) / 2
        D[:, i, j, j, i] = D[:, j, i, i, j] = (symmetric - rotation) / 2
    Q = np.einsum("mip,mqj->mijpq", U, Vt).reshape(-1, 9, 9)
    return (Q @ D.reshape(-1, 9, 9) @ Q.transpose(0, 2, 1)).reshape(-1, 3, 3, 3, 3)


def _on_curve(sigma: Floats, s3: Floats) -> Floats:
    """The stationary stretches whose smallest is s3, shape (m, 3)."""
    c = s3 * (s3 - sigma[:, 2])
    root = np.sqrt(np.maximum(sigma[:, :2] ** 2 + 4 * c[:, None], 0))
    return np.column_stack([(sigma[:, :2] + root) / 2, s3])


def _excess(sigma: Floats, target: Floats, s3: Floats) -> Floats:
    return np.prod(_on_curve(sigma, s3), axis=1) - target


def _root(sigma: Floats, target: Floats, low: Floats, high: Floats) -> Floats:
    """The root s3 of the product's excess in [low, high], where it is <= 0 and >= 0, to the last digits.

    Newton's method, and bisection where a step leaves the bracket or is more than half of the one before.
    """
    low, high = low.copy(), high.copy()
    s3 = (low + high) / 2
    step = high - low
    for _ in range(ROOT_ITERATIONS):
        s = _on_curve(sigma, s3)
        product = np.prod(s, axis=1)
        below = product < target
        low[below], high[~below] = s3[below], s3[~below]
        # d ln s_i / d s_3 on the curve, from s_i (s_i - sigma_i) = s_3 (s_3 - sigma_3).
        split = s[:, :2] * (2 * s[:, :2] - sigma[:, :2])
        growth = 1 / s3 + (2 * s3 - sigma[:, 2]) * np.sum(1 / np.maximum(split, TINY), axis=1)
        newton = (target - product) / np.where(growth > 0, product * growth, TINY)
        settled = np.abs(newton) <= 1e-14 * s3
        inside = (s3 + newton > low) & (s3 + newton < high) & (np.abs(newton) <= np.abs(step) / 2)
        step = np.where(settled, 0.0, np.where(inside, newton, (low + high) / 2 - s3))
        if settled.all():
            return s3 + newton
        s3 = s3 + step
    return s3


def _nearest_root(sigma: Floats, target: Floats) -> Floats:
    """Of the smallest and the largest root in (0, sigma_3), the one whose stretches are nearer to sigma."""
    if not len(sigma):
        return np.zeros(0)
    fractions = np.linspace(0, 1, 33)
    excess = np.stack([_excess(sigma, target, f * sigma[:, 2]) for f in fractions])
    first = np.argmax(excess > 0, axis=0)
    last = len(fractions) - 1 - np.argmax(excess[::-1] <= 0, axis=0)
    roots = []
    for lower in (first - 1, last):
        low, high = fractions[lower] * sigma[:, 2], fractions[lower + 1] * sigma[:, 2]
        roots.append(_root(sigma, target, low, high))
    distance = [np.sum((_on_curve(sigma, root) - sigma) ** 2, axis=1) for root in roots]
    return np.where(distance[0] < distance[1], roots[0], roots[1])


def _slope(sigma: Floats, s: Floats) -> Floats:
    """ds/dsigma, shape (m, 3, 3), by differentiating the Karush-Kuhn-Tucker system of the projection.

    With a multiplier nu, s - sigma + nu (s_2 s_3, s_1 s_3, s_1 s_2) = 0 and s_1 s_2 s_3 = target.
    """
    cofactor = np.stack([s[:, 1] * s[:, 2], s[:, 0] * s[:, 2], s[:, 0] * s[:, 1]], axis=1)
    nu = np.einsum("mi,mi->m", sigma - s, cofactor) / np.einsum("mi,mi->m", cofactor, cofactor)
    K = np.zeros((len(s), 4, 4))
    K[:, :3, :3] = np.eye(3)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[:, i, j] = K[:, j, i] = nu * s[:, k]
    K[:, :3, 3] = K[:, 3, :3] = cofactor
    # Where two nearest points merge, as at F = 2 I for the target 1, the system is singular.
    return np.linalg.pinv(K, rcond=1e-12, hermitian=True)[:, :3, :3]
