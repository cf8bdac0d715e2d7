"""The compressible neo-Hookean law with a logarithmic volumetric part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .material import LameLaw, MixedLaw, check_positive
from .volumetric import Bulk, by_pressure, quadratic


@dataclass(frozen=True)
class NeoHookean(LameLaw, MixedLaw):
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J (Bonet and Wood 2008, Eq. 6.27); mu and lmbda [kPa].

    Infinite for J <= 0. Raises SceneError unless mu > 0 and lmbda > -2/3 mu; mixed elements need lmbda > 0.
    """

    def density(self, I1: Any, I2: Any, J: Any, p: Any, m: Any, bulk: Bulk = quadratic) -> Any:
        log_J = m.log(J)
        return p.mu / 2 * (I1 - 3) - p.mu * log_J + bulk(p.lmbda, log_J)

    def mixed_density(self, I1: Any, I2: Any, J: Any, pressure: Any, p: Any, m: Any) -> Any:
        """See MixedLaw: lmbda/2 ln²J by the pressure lmbda ln J, but for a share of it.

        That share, mu/lmbda or a half, stays at the points: alone a tension above mu would beat -mu ln J as J falls to
        0, and crush single points.
        """
        share = m.where(2 * p.mu < p.lmbda, p.mu / p.lmbda, 0.5)
        mixed = by_pressure(pressure)
        return self.density(
            I1, I2, J, p, m, lambda modulus, g: share * quadratic(modulus, g) + (1 - share) * mixed(modulus, g)
        )

    def check_mixed(self):
        check_positive(self, "lmbda")
