"""The compressible neo-Hookean law with a logarithmic volumetric part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from .isochoric_neo_hookean import IsochoricNeoHookean
from .material import EnergyLaw, LameLaw, check_positive
from .volumetric import by_pressure, quadratic


@dataclass(frozen=True)
class NeoHookean(LameLaw, EnergyLaw):
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J (Bonet and Wood 2008, Eq. 6.27); mu and lmbda [kPa].

    Infinite for J <= 0. Raises SceneError unless mu > 0 and lmbda > -2/3 mu; mixed elements need lmbda > 0.
    """

    @staticmethod
    def density(F, p, bulk=quadratic):
        """See HasDensity; not a number where J <= 0."""
        import ufl

        log_J = ufl.ln(ufl.det(F))
        return p.mu / 2 * (ufl.inner(F, F) - 3) - p.mu * log_J + bulk(p.lmbda, log_J)

    @classmethod
    def mixed_density(cls, F, pressure, p):
        """See HasMixedDensity: lmbda/2 ln²J by the pressure lmbda ln J, but for a share of it.

        That share, mu/lmbda or a half, stays at the points: alone a tension above mu would beat -mu ln J as J falls to
        0, and crush single points.
        """
        import ufl

        share = ufl.conditional(ufl.lt(2 * p.mu, p.lmbda), p.mu / p.lmbda, 0.5)
        mixed = by_pressure(pressure)
        return cls.density(F, p, lambda modulus, g: share * quadratic(modulus, g) + (1 - share) * mixed(modulus, g))

    isochoric = staticmethod(IsochoricNeoHookean.isochoric)

    def check_mixed(self):
        """See HasMixedDensity."""
        check_positive(self, "lmbda")

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasInvariants."""
        holds, J = J > 0, np.where(J > 0, J, 1.0)
        log_J = np.log(J)
        psi = self.mu / 2 * (I1 - 3) - self.mu * log_J + self.lmbda / 2 * log_J**2
        gradient, hessian = np.zeros((len(J), 3)), np.zeros((len(J), 3, 3))
        gradient[:, 0] = self.mu / 2
        gradient[:, 2] = (self.lmbda * log_J - self.mu) / J
        hessian[:, 2, 2] = (self.lmbda * (1 - log_J) + self.mu) / J**2
        return np.where(holds, psi, np.inf), gradient, hessian
