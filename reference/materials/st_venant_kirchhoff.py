"""The St. Venant-Kirchhoff law: linear elasticity in Green's strain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from .material import EnergyLaw, LameLaw, check_positive
from .volumetric import by_pressure, quadratic


@dataclass(frozen=True)
class StVenantKirchhoff(LameLaw, EnergyLaw):
    """psi = mu tr E² + lmbda/2 tr²E, E = (FᵀF - I)/2 (Bonet and Wood 2008, Eq. 6.25); mu and lmbda [kPa].

    For small strains only: it softens under compression and does not see inversion, F and -F cost the same.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu; mixed elements need lmbda > 0.
    """

    finite_inverted = True

    @staticmethod
    def density(F, p, bulk=quadratic):
        """See HasDensity."""
        import ufl

        E = (F.T * F - ufl.Identity(3)) / 2
        return p.mu * ufl.inner(E, E) + bulk(p.lmbda, ufl.tr(E))

    @classmethod
    def mixed_density(cls, F, pressure, p):
        """See HasMixedDensity."""
        return cls.density(F, p, by_pressure(pressure))

    @staticmethod
    def isochoric(F, p):
        """See HasMixedDensity: the law of J^(-2/3) FᵀF."""
        import ufl

        E = (ufl.det(F) ** (-2 / 3) * F.T * F - ufl.Identity(3)) / 2
        return p.mu * ufl.inner(E, E) + p.lmbda / 2 * ufl.tr(E) ** 2

    def check_mixed(self):
        """See HasMixedDensity."""
        check_positive(self, "lmbda")

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasInvariants; tr E = (I1 - 3)/2 and tr E² = (I1² - 2 I1 - 2 I2 + 3)/4."""
        psi = self.mu / 4 * (I1**2 - 2 * I1 - 2 * I2 + 3) + self.lmbda / 8 * (I1 - 3) ** 2
        gradient, hessian = np.zeros((len(J), 3)), np.zeros((len(J), 3, 3))
        gradient[:, 0] = self.mu / 2 * (I1 - 1) + self.lmbda / 4 * (I1 - 3)
        gradient[:, 1] = -self.mu / 2
        hessian[:, 0, 0] = self.mu / 2 + self.lmbda / 4
        return psi, gradient, hessian
