"""The St. Venant-Kirchhoff law: linear elasticity in Green's strain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .material import LameLaw, MixedLaw, check_positive
from .volumetric import Bulk, by_pressure, quadratic


@dataclass(frozen=True)
class StVenantKirchhoff(LameLaw, MixedLaw):
    """psi = mu tr E² + lmbda/2 tr²E, E = (FᵀF - I)/2 (Bonet and Wood 2008, Eq. 6.25); mu and lmbda [kPa].

    For small strains only: it softens under compression and does not see inversion, F and -F cost the same.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu; mixed elements need lmbda > 0.
    """

    finite_inverted = True

    def density(self, I1: Any, I2: Any, J: Any, p: Any, m: Any, bulk: Bulk = quadratic) -> Any:
        """See EnergyLaw; tr E = (I1 - 3)/2 and tr E² = (I1² - 2 I1 - 2 I2 + 3)/4."""
        return p.mu / 4 * (I1**2 - 2 * I1 - 2 * I2 + 3) + bulk(p.lmbda, (I1 - 3) / 2)

    def mixed_density(self, I1: Any, I2: Any, J: Any, pressure: Any, p: Any, m: Any) -> Any:
        return self.density(I1, I2, J, p, m, by_pressure(pressure))

    def check_mixed(self):
        check_positive(self, "lmbda")
