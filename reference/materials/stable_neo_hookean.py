"""The stable neo-Hookean law, which is finite and smooth through inversion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from .material import EnergyLaw, LameLaw
from .volumetric import by_pressure, quadratic


@dataclass(frozen=True)
class StableNeoHookean(LameLaw, EnergyLaw):
    """psi = m/2 (I1 - 3) + l/2 (J - a)² - m/2 ln(I1 + 1) up to a constant, m = 4/3 mu, l = lmbda + 5/6 mu.

    a = 1 + m/l - m/(4 l) makes rest free of stress; m and l make mu and lmbda [kPa] the moduli there (Smith, de Goes,
    Kim 2018, "Stable Neo-Hookean Flesh Simulation", Section 3.4). psi is 0 at rest and finite for every F.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    finite_inverted = True

    @staticmethod
    def density(F, p, bulk=quadratic):
        """See HasDensity."""
        import ufl

        m, k = 4 * p.mu / 3, p.lmbda + 5 * p.mu / 6
        I1, away = ufl.inner(F, F), ufl.det(F) - 1
        # k/2 (J - a)² less its value at rest, with k (a - 1) = 3/4 m
        volume = bulk(k, away) - 3 * m / 4 * away
        return m / 2 * (I1 - 3) + volume - m / 2 * ufl.ln((I1 + 1) / 4)

    @classmethod
    def mixed_density(cls, F, pressure, p):
        """See HasMixedDensity."""
        return cls.density(F, p, by_pressure(pressure))

    @staticmethod
    def isochoric(F, p):
        """See HasMixedDensity: the law where J = 1, of J^(-2/3) I1."""
        import ufl

        I1 = ufl.det(F) ** (-2 / 3) * ufl.inner(F, F)
        return 2 * p.mu / 3 * (I1 - 3 - ufl.ln((I1 + 1) / 4))

    def check_mixed(self):
        """See HasMixedDensity; l is positive already."""

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasInvariants."""
        m, k = 4 * self.mu / 3, self.lmbda + 5 * self.mu / 6
        a = 1 + m / k - m / (4 * k)
        psi = m / 2 * (I1 - 3 - np.log((I1 + 1) / 4)) + k / 2 * ((J - a) ** 2 - (1 - a) ** 2)
        gradient, hessian = np.zeros((len(J), 3)), np.zeros((len(J), 3, 3))
        gradient[:, 0] = m / 2 * I1 / (I1 + 1)
        gradient[:, 2] = k * (J - a)
        hessian[:, 0, 0] = m / 2 / (I1 + 1) ** 2
        hessian[:, 2, 2] = k
        return psi, gradient, hessian
