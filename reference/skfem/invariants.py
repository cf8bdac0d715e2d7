"""Isotropic laws as functions psi(I1, I2, J) of the invariants of C = FᵀF, with stress and tangent by the chain rule.

I1 = tr C, I2 = (tr² C - tr C²)/2, J = det F. Each law gives psi (m,), its gradient (m, 3) and its Hessian (m, 3, 3) by
(I1, I2, J); the invariants' own derivatives by F are polynomials, so they hold for every F.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from ..materials import EnergyLaw, Volumetric
from .laws import IDENTITY

LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1.0


class InvariantLaw(ABC):
    """See Law; what is derived from `by_invariants`."""

    @abstractmethod
    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """Give psi (m,), its gradient (m, 3) and Hessian (m, 3, 3) by (I1, I2, J) [kPa]."""

    def psi(self, F: Floats) -> Floats:
        """See Law."""
        return self.by_invariants(*_invariants(F))[0]

    def stress(self, F: Floats) -> Floats:
        """See Law; F must have finite energy."""
        gradient = self.by_invariants(*_invariants(F))[1]
        return np.einsum("ma,maij->mij", gradient, _first(F))

    def tangent(self, F: Floats) -> Floats:
        """See Law; F must have finite energy."""
        _, gradient, hessian = self.by_invariants(*_invariants(F))
        first = _first(F)
        bent = np.einsum("ma,maijkl->mijkl", gradient, _second(F))
        return bent + np.einsum("maij,mab,mbkl->mijkl", first, hessian, first, optimize=True)


@dataclass(frozen=True)
class StableNeoHookean(InvariantLaw):
    """See materials.StableNeoHookean; 0 at rest."""

    mu: float
    lmbda: float

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See InvariantLaw."""
        m, k = 4 * self.mu / 3, self.lmbda + 5 * self.mu / 6
        a = 1 + m / k - m / (4 * k)
        psi = m / 2 * (I1 - 3 - np.log((I1 + 1) / 4)) + k / 2 * ((J - a) ** 2 - (1 - a) ** 2)
        gradient, hessian = np.zeros((len(J), 3)), np.zeros((len(J), 3, 3))
        gradient[:, 0] = m / 2 * I1 / (I1 + 1)
        gradient[:, 2] = k * (J - a)
        hessian[:, 0, 0] = m / 2 / (I1 + 1) ** 2
        hessian[:, 2, 2] = k
        return psi, gradient, hessian


@dataclass(frozen=True)
class StVenantKirchhoff(InvariantLaw):
    """See materials.StVenantKirchhoff; tr E = (I1 - 3)/2 and tr E² = (I1² - 2 I1 - 2 I2 + 3)/4."""

    mu: float
    lmbda: float

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See InvariantLaw."""
        psi = self.mu / 4 * (I1**2 - 2 * I1 - 2 * I2 + 3) + self.lmbda / 8 * (I1 - 3) ** 2
        gradient, hessian = np.zeros((len(J), 3)), np.zeros((len(J), 3, 3))
        gradient[:, 0] = self.mu / 2 * (I1 - 1) + self.lmbda / 4 * (I1 - 3)
        gradient[:, 1] = -self.mu / 2
        hessian[:, 0, 0] = self.mu / 2 + self.lmbda / 4
        return psi, gradient, hessian


@dataclass(frozen=True)
class Brought(InvariantLaw):
    """A law that brings its energy along."""

    law: EnergyLaw

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See InvariantLaw."""
        return self.law.by_invariants(I1, I2, J)


@dataclass(frozen=True)
class IsochoricPolynomial(InvariantLaw):
    """C10 (i1 - 3) + C01 (i2 - 3) + C20 (i1 - 3)² + U(J), i1 = J^(-2/3) I1, i2 = J^(-4/3) I2; infinite for J <= 0."""

    C10: float
    C01: float
    C20: float
    kappa: float
    volumetric: Volumetric

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See InvariantLaw; no derivatives where J <= 0."""
        holds, J = J > 0, np.where(J > 0, J, 1.0)
        a, b = J ** (-2 / 3), J ** (-4 / 3)
        i1, i2 = a * I1, b * I2
        by_i1 = self.C10 + 2 * self.C20 * (i1 - 3)
        U, dU, ddU = self._volume(J)
        psi = self.C10 * (i1 - 3) + self.C01 * (i2 - 3) + self.C20 * (i1 - 3) ** 2 + U
        gradient, hessian = np.zeros((len(J), 3)), np.zeros((len(J), 3, 3))
        gradient[:, 0] = by_i1 * a
        gradient[:, 1] = self.C01 * b
        gradient[:, 2] = -(2 * by_i1 * i1 + 4 * self.C01 * i2) / (3 * J) + dU
        hessian[:, 0, 0] = 2 * self.C20 * a**2
        hessian[:, 0, 2] = hessian[:, 2, 0] = -2 / 3 * a / J * (by_i1 + 2 * self.C20 * i1)
        hessian[:, 1, 2] = hessian[:, 2, 1] = -4 / 3 * self.C01 * b / J
        hessian[:, 2, 2] = (8 * self.C20 * i1**2 + 10 * by_i1 * i1 + 28 * self.C01 * i2) / (9 * J**2) + ddU
        return np.where(holds, psi, np.inf), gradient, hessian

    def _volume(self, J: Floats) -> tuple[Floats, Floats, Floats | float]:
        """U, U' and U''."""
        if self.volumetric is Volumetric.QUADRATIC:
            return self.kappa / 2 * (J - 1) ** 2, self.kappa * (J - 1), self.kappa
        k = self.kappa / 2
        return k / 2 * (J**2 - 1 - 2 * np.log(J)), k * (J - 1 / J), k * (1 + 1 / J**2)


def _invariants(F: Floats) -> tuple[Floats, Floats, Floats]:
    C = F.transpose(0, 2, 1) @ F
    I1 = np.trace(C, axis1=1, axis2=2)
    return I1, (I1**2 - np.einsum("mij,mij->m", C, C)) / 2, np.linalg.det(F)


def _cofactor(F: Floats) -> Floats:
    """det(F) F^(-T), also where F is singular."""
    return np.stack([np.cross(F[:, 1], F[:, 2]), np.cross(F[:, 2], F[:, 0]), np.cross(F[:, 0], F[:, 1])], axis=1)


def _first(F: Floats) -> Floats:
    """The derivatives of (I1, I2, J) by F, shape (m, 3, 3, 3)."""
    I1 = np.einsum("mij,mij->m", F, F)[:, None, None]
    return np.stack([2 * F, 2 * I1 * F - 2 * F @ F.transpose(0, 2, 1) @ F, _cofactor(F)], axis=1)


def _second(F: Floats) -> Floats:
    """The second derivatives of (I1, I2, J) by F, shape (m, 3, 3, 3, 3, 3)."""
    eye, FT = np.eye(3), F.transpose(0, 2, 1)
    I1 = np.einsum("mij,mij->m", F, F)
    of_I2 = 4 * np.einsum("mij,mkl->mijkl", F, F) + 2 * I1[:, None, None, None, None] * IDENTITY
    of_I2 -= 2 * np.einsum("ik,mjl->mijkl", eye, FT @ F) + 2 * np.einsum("mil,mkj->mijkl", F, F)
    of_I2 -= 2 * np.einsum("mik,jl->mijkl", F @ FT, eye)
    of_J = np.einsum("ika,jlb,mab->mijkl", LEVI_CIVITA, LEVI_CIVITA, F, optimize=True)
    return np.stack([np.broadcast_to(2 * IDENTITY, of_J.shape), of_I2, of_J], axis=1)
