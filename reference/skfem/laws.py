"""Energy densities of tets with stress and tangent, written apart from the other solvers' so that one checks the other.

Every law has `psi(F)` [kPa], shape (m,); `stress(F)`, the first Piola-Kirchhoff stress [kPa], shape (m, 3, 3); and
`tangent(F)` = dP/dF [kPa], shape (m, 3, 3, 3, 3), for deformation gradients F of shape (m, 3, 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...lhm.base.mesh import Floats
from .projections import clamp_stretches, nearest_of_determinant, projection_derivative, signed_svd

IDENTITY = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))


class Law(Protocol):
    """A density with its two derivatives; see the module."""

    def psi(self, F: Floats) -> Floats:
        """Energy per rest volume [kPa], shape (m,); infinite where the law does not hold."""
        ...

    def stress(self, F: Floats) -> Floats:
        """dpsi/dF [kPa], shape (m, 3, 3)."""
        ...

    def tangent(self, F: Floats) -> Floats:
        """dP/dF [kPa], shape (m, 3, 3, 3, 3)."""
        ...


@dataclass(frozen=True)
class NeoHookean:
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J (Bonet and Wood 2008, Eq. 6.27); infinite for J <= 0."""

    mu: float
    lmbda: float

    def psi(self, F: Floats) -> Floats:
        """See Law."""
        J = np.linalg.det(F)
        log_J = np.log(J, out=np.zeros_like(J), where=J > 0)
        psi = self.mu / 2 * (np.einsum("mij,mij->m", F, F) - 3)
        return np.where(J > 0, psi - self.mu * log_J + self.lmbda / 2 * log_J**2, np.inf)

    def stress(self, F: Floats) -> Floats:
        """See Law; F must have J > 0."""
        inverse_T = np.linalg.inv(F).transpose(0, 2, 1)
        log_J = np.log(np.linalg.det(F))[:, None, None]
        return self.mu * (F - inverse_T) + self.lmbda * log_J * inverse_T

    def tangent(self, F: Floats) -> Floats:
        """See Law; F must have J > 0."""
        inverse = np.linalg.inv(F)
        log_J = np.log(np.linalg.det(F))
        shear = np.einsum("m,mli,mjk->mijkl", self.mu - self.lmbda * log_J, inverse, inverse)
        return self.mu * IDENTITY + shear + self.lmbda * np.einsum("mji,mlk->mijkl", inverse, inverse)


@dataclass(frozen=True)
class Corotated:
    """psi = mu ‖F - R‖² + lmbda/2 tr²(S - I), F = R S; R is the rotation nearest to F."""

    mu: float
    lmbda: float

    def psi(self, F: Floats) -> Floats:
        """See Law."""
        _, sigma, _ = signed_svd(F)
        return self.mu * np.sum((sigma - 1) ** 2, axis=1) + self.lmbda / 2 * np.sum(sigma - 1, axis=1) ** 2

    def stress(self, F: Floats) -> Floats:
        """See Law; tr S = R : F, whose derivative by F is R."""
        U, sigma, Vt = signed_svd(F)
        R = U @ Vt
        return 2 * self.mu * (F - R) + self.lmbda * np.sum(sigma - 1, axis=1)[:, None, None] * R

    def tangent(self, F: Floats) -> Floats:
        """See Law."""
        U, sigma, Vt = signed_svd(F)
        R = U @ Vt
        turning = projection_derivative(U, sigma, Vt, np.ones_like(sigma), np.zeros_like(F))
        trace = np.sum(sigma - 1, axis=1)[:, None, None, None, None]
        along = self.lmbda * np.einsum("mij,mkl->mijkl", R, R)
        return 2 * self.mu * IDENTITY + (self.lmbda * trace - 2 * self.mu) * turning + along


@dataclass(frozen=True, eq=False)
class Strain:
    """stiffness/2 times F's squared distance to the matrices with stretches in [1/limit, limit] (SoftDECA Eq. 10).

    limit = 1 gives stiffness/2 ‖F - R‖². stiffness [kPa] and limit, shape (m,). Of grown tissue the law is Grown.
    """

    stiffness: Floats
    limit: Floats

    def psi(self, F: Floats) -> Floats:
        """See Law."""
        _, sigma, _ = signed_svd(F)
        return self.stiffness / 2 * np.sum((sigma - clamp_stretches(sigma, self.limit)[0]) ** 2, axis=1)

    def stress(self, F: Floats) -> Floats:
        """See Law."""
        U, sigma, Vt = signed_svd(F)
        excess = sigma - clamp_stretches(sigma, self.limit)[0]
        return self.stiffness[:, None, None] * (U * excess[:, None, :]) @ Vt

    def tangent(self, F: Floats) -> Floats:
        """See Law; the derivative that holds on the side of the kink where F is."""
        U, sigma, Vt = signed_svd(F)
        nearest, slope = clamp_stretches(sigma, self.limit)
        derivative = projection_derivative(U, sigma, Vt, nearest, slope)
        return self.stiffness[:, None, None, None, None] * (IDENTITY - derivative)


@dataclass(frozen=True, eq=False)
class Volume:
    """stiffness/2 times F's squared distance to the matrices of determinant `target` (SoftDECA Eq. 10).

    stiffness [kPa] and target, shape (m,).
    """

    stiffness: Floats
    target: Floats

    def psi(self, F: Floats) -> Floats:
        """See Law."""
        _, sigma, _ = signed_svd(F)
        return self.stiffness / 2 * np.sum((sigma - nearest_of_determinant(sigma, self.target)[0]) ** 2, axis=1)

    def stress(self, F: Floats) -> Floats:
        """See Law."""
        U, sigma, Vt = signed_svd(F)
        excess = sigma - nearest_of_determinant(sigma, self.target)[0]
        return self.stiffness[:, None, None] * (U * excess[:, None, :]) @ Vt

    def tangent(self, F: Floats) -> Floats:
        """See Law."""
        U, sigma, Vt = signed_svd(F)
        nearest, slope = nearest_of_determinant(sigma, self.target)
        derivative = projection_derivative(U, sigma, Vt, nearest, slope)
        return self.stiffness[:, None, None, None, None] * (IDENTITY - derivative)


@dataclass(frozen=True, eq=False)
class Grown:
    """weight psi(F growth^(-1/3)) of another law (Rodriguez, Hoger, McCulloch 1994); weight and growth, shape (m,)."""

    law: Law
    growth: Floats
    weight: Floats

    def _elastic(self, F: Floats) -> Floats:
        return F * self._slope[:, None, None]

    @property
    def _slope(self) -> Floats:
        return self.growth ** (-1 / 3)

    def psi(self, F: Floats) -> Floats:
        """See Law."""
        return self.weight * self.law.psi(self._elastic(F))

    def stress(self, F: Floats) -> Floats:
        """See Law."""
        return (self.weight * self._slope)[:, None, None] * self.law.stress(self._elastic(F))

    def tangent(self, F: Floats) -> Floats:
        """See Law."""
        return (self.weight * self._slope**2)[:, None, None, None, None] * self.law.tangent(self._elastic(F))


def project_spd(tangent: Floats) -> Floats:
    """The nearest positive semi-definite tangents in the Frobenius norm, of the same shape (m, 3, k, 3, k)."""
    size = tangent.shape[1] * tangent.shape[2]
    values, vectors = np.linalg.eigh(tangent.reshape(-1, size, size))
    bad = values[:, 0] < 0
    projected = tangent.reshape(-1, size, size).copy()
    projected[bad] = (vectors[bad] * np.maximum(values[bad], 0)[:, None, :]) @ vectors[bad].transpose(0, 2, 1)
    return projected.reshape(tangent.shape)
