"""The singular values nearest to given ones with a given determinant, and their derivative."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def _others(s1, s2, s3, tau):
    """The two larger entries of a stationary point whose third is tau, and d ln(t1 t2)/d tau."""
    mu = tau * (tau - s3)
    r1, r2 = np.sqrt(max(s1 * s1 + 4.0 * mu, 0.0)), np.sqrt(max(s2 * s2 + 4.0 * mu, 0.0))
    t1, t2 = 0.5 * (s1 + r1), 0.5 * (s2 + r2)
    slope = (2.0 * tau - s3) * (1.0 / max(t1 * r1, 1e-300) + 1.0 / max(t2 * r2, 1e-300))
    return t1, t2, slope


@njit(cache=True)
def nearest_with_determinant(s, target):
    """The t (m, 3) nearest to s (m, 3) with t₁ t₂ t₃ = target > 0, all entries positive.

    Stationary points obey t_i (t_i - s_i) = μ, so t₃ = τ alone decides: μ = τ(τ - s₃), and t₁, t₂ take the larger root.
    The product grows with τ on the bracket chosen below, where Newton is kept by bisection.
    """
    out = np.empty_like(s)
    for e in range(len(s)):
        s1, s2, s3, v = s[e, 0], s[e, 1], s[e, 2], target[e]
        if s3 <= 0.0 or s1 * s2 * s3 <= v:
            low, high = max(s3, 0.0), v ** (1.0 / 3.0)
        else:
            low, high = 0.5 * s3, s3
            t1, t2, _ = _others(s1, s2, s3, low)
            if t1 * t2 * low > v:  # far above the target: the smallest stretch takes the smaller root
                low, high = 0.0, low
        tau = min(max(s3, low), high)
        if tau <= 0.0:
            tau = high
        for _ in range(200):
            t1, t2, slope = _others(s1, s2, s3, tau)
            product = t1 * t2 * tau
            if product > v:
                high = tau
            else:
                low = tau
            gain = product * (1.0 / tau + slope)
            step = (product - v) / gain if gain > 0.0 else np.inf
            after = tau - step
            if not (low <= after <= high):
                after = 0.5 * (low + high)
            if abs(after - tau) <= 4e-16 * tau:
                break
            tau = after
        t1, t2, _ = _others(s1, s2, s3, tau)
        out[e, 0], out[e, 1], out[e, 2] = t1, t2, tau
    return out


@njit(inline="always")
def _unit(x, y, z):
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@njit(cache=True)
def nearest_derivative(s, t):
    """dt/ds (m, 3, 3) of the nearest point with a given determinant.

    Differentiating t - s = λ∇c(t), c(t) = target: dt = Z (Zᵀ M Z)⁻¹ Zᵀ ds, Z a basis of the surface's tangent plane and
    M = I - λ∇²c, whose entries off the diagonal are -μ/(t_i t_j), μ = t_i (t_i - s_i).
    """
    out = np.empty((len(s), 3, 3))
    for e in range(len(s)):
        t1, t2, t3 = t[e, 0], t[e, 1], t[e, 2]
        mu = t3 * (t3 - s[e, 2])
        m12, m13, m23 = -mu / (t1 * t2), -mu / (t1 * t3), -mu / (t2 * t3)
        n = _unit(t2 * t3, t1 * t3, t1 * t2)
        a = (n[1] - n[2], n[2] - n[0], n[0] - n[1])
        if a[0] * a[0] + a[1] * a[1] + a[2] * a[2] < 0.25:
            a = (-n[1], n[0], 0.0)
        a = _unit(a[0], a[1], a[2])
        b = (n[1] * a[2] - n[2] * a[1], n[2] * a[0] - n[0] * a[2], n[0] * a[1] - n[1] * a[0])
        maa = 1.0 + 2.0 * (m12 * a[0] * a[1] + m13 * a[0] * a[2] + m23 * a[1] * a[2])
        mbb = 1.0 + 2.0 * (m12 * b[0] * b[1] + m13 * b[0] * b[2] + m23 * b[1] * b[2])
        mab = m12 * (a[0] * b[1] + a[1] * b[0]) + m13 * (a[0] * b[2] + a[2] * b[0]) + m23 * (a[1] * b[2] + a[2] * b[1])
        det = max(maa * mbb - mab * mab, 1e-12)  # zero where two nearest points merge
        for i in range(3):
            for j in range(3):
                out[e, i, j] = (mbb * a[i] * a[j] - mab * (a[i] * b[j] + b[i] * a[j]) + maa * b[i] * b[j]) / det
    return out
