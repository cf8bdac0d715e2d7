"""Energy densities as functions of signed singular values: PD's strain and volume energies, corotated, neo-Hookean.

Each law gives psi (m,) with gradient (m, 3) and Hessian (m, 3, 3) at singular values s (m, 3) that come ordered as
`principal.signed_svd` orders them. The neo-Hookean laws here serve for the tangent; energy and stress come from UFL.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit

from ...lhm.base.mesh import Floats

DIAGONAL = np.arange(3)


class PrincipalLaw(Protocol):
    """psi, its gradient and its Hessian [kPa] at singular values s (m, 3)."""

    def evaluate(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """Give psi (m,), p (m, 3), h (m, 3, 3)."""
        ...


@dataclass(frozen=True, eq=False)
class StrainLaw:
    """stiffness/2 times the squared distance of s to [1/limit, limit] growth^(1/3).

    stiffness [kPa], limit and growth are (m,).
    """

    stiffness: Floats
    limit: Floats
    growth: Floats

    def evaluate(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """psi, p, h; at a limit above 1 the curvature is that of the free side."""
        limit, stiffness = self.limit[:, None], self.stiffness[:, None]
        size = np.cbrt(self.growth)[:, None]
        beyond = s - np.clip(s, size / limit, size * limit)
        h = np.zeros((len(s), 3, 3))
        h[:, DIAGONAL, DIAGONAL] = stiffness * ((beyond != 0.0) | (limit == 1.0))
        return 0.5 * self.stiffness * np.sum(beyond**2, axis=1), stiffness * beyond, h


@dataclass(frozen=True, eq=False)
class VolumeLaw:
    """stiffness/2 times the squared distance of F to {det = target}; stiffness [kPa] and target are (m,)."""

    stiffness: Floats
    target: Floats

    def evaluate(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """psi, p, h; the nearest point's derivative is implicit (see `_nearest_derivative`)."""
        t = nearest_with_determinant(s, self.target)
        away = s - t
        h = self.stiffness[:, None, None] * (np.eye(3) - _nearest_derivative(s, t))
        return 0.5 * self.stiffness * np.sum(away**2, axis=1), self.stiffness[:, None] * away, h


@dataclass(frozen=True, eq=False)
class Grown:
    """growth psi(s growth^(-1/3)) of another law; growth is (m,)."""

    law: PrincipalLaw
    growth: Floats

    def evaluate(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """psi, p, h."""
        size = np.cbrt(self.growth)
        psi, p, h = self.law.evaluate(s / size[:, None])
        return self.growth * psi, (size**2)[:, None] * p, size[:, None, None] * h


@dataclass(frozen=True, eq=False)
class CorotatedLaw:
    """mu Σ(s - 1)² + lmbda/2 (Σ(s - 1))²; mu and lmbda [kPa] are (m,)."""

    mu: Floats
    lmbda: Floats

    def evaluate(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """psi, p, h."""
        strain = s - 1.0
        trace = strain.sum(axis=1)
        psi = self.mu * np.sum(strain**2, axis=1) + 0.5 * self.lmbda * trace**2
        p = 2.0 * self.mu[:, None] * strain + (self.lmbda * trace)[:, None]
        h = 2.0 * self.mu[:, None, None] * np.eye(3) + self.lmbda[:, None, None]
        return psi, p, h


@dataclass(frozen=True, eq=False)
class NeoHookeanLaw:
    """mu/2 (Σs² - 3) - mu ln J + lmbda/2 ln²J; mu and lmbda [kPa] are (m,). Needs J > 0."""

    mu: Floats
    lmbda: Floats

    def evaluate(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """psi, p, h."""
        log_J = np.log(np.prod(s, axis=1))
        psi = 0.5 * self.mu * (np.sum(s**2, axis=1) - 3.0) - self.mu * log_J + 0.5 * self.lmbda * log_J**2
        inverse = 1.0 / s
        pull = (self.lmbda * log_J - self.mu)[:, None]
        p = self.mu[:, None] * s + pull * inverse
        h = self.lmbda[:, None, None] * inverse[:, :, None] * inverse[:, None, :]
        h[:, DIAGONAL, DIAGONAL] += self.mu[:, None] - pull * inverse**2
        return psi, p, h


@dataclass(frozen=True, eq=False)
class StableNeoHookeanLaw:
    """See `densities.stable_neo_hookean`; mu and lmbda [kPa], those at rest, are (m,)."""

    mu: Floats
    lmbda: Floats

    def evaluate(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """psi, p, h."""
        mu, lmbda = 4.0 * self.mu / 3.0, self.lmbda + 5.0 * self.mu / 6.0
        squares, away = np.sum(s**2, axis=1), np.prod(s, axis=1) - 1.0
        psi = 0.5 * mu * (squares - 3.0 - np.log((squares + 1.0) / 4.0)) + 0.5 * lmbda * away**2 - 0.75 * mu * away
        pull, shear = lmbda * away - 0.75 * mu, mu * squares / (squares + 1.0)
        cofactors = np.roll(s, 1, axis=1) * np.roll(s, 2, axis=1)
        p = shear[:, None] * s + pull[:, None] * cofactors
        h = (2.0 * mu / (squares + 1.0) ** 2)[:, None, None] * s[:, :, None] * s[:, None, :]
        h += lmbda[:, None, None] * cofactors[:, :, None] * cofactors[:, None, :]
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            h[:, i, i] += shear
            h[:, i, j] += pull * s[:, k]
            h[:, j, i] += pull * s[:, k]
        return psi, p, h


@njit(cache=True)
def add_at(points, psi, p, h, into_psi, into_p, into_h):
    """Add what a law gives at some points (m,) to the sums of all laws at all points."""
    for n in range(len(points)):
        at = points[n]
        into_psi[at] += psi[n]
        for i in range(3):
            into_p[at, i] += p[n, i]
            for j in range(3):
                into_h[at, i, j] += h[n, i, j]


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
def _nearest_derivative(s, t):
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
