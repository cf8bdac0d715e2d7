"""The stable neo-Hookean law, which is finite and smooth through inversion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .material import LameLaw, MixedLaw
from .volumetric import Bulk, by_pressure, quadratic


@dataclass(frozen=True)
class StableNeoHookean(LameLaw, MixedLaw):
    """psi = m/2 (I1 - 3) + l/2 (J - a)² - m/2 ln(I1 + 1) up to a constant, m = 4/3 mu, l = lmbda + 5/6 mu.

    a = 1 + m/l - m/(4 l) makes rest free of stress; m and l make mu and lmbda [kPa] the moduli there (Smith, de Goes,
    Kim 2018, "Stable Neo-Hookean Flesh Simulation", Section 3.4). psi is 0 at rest and finite for every F.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    finite_inverted = True

    def density(self, I1: Any, I2: Any, J: Any, p: Any, m: Any, bulk: Bulk = quadratic) -> Any:
        shear, k = 4 * p.mu / 3, p.lmbda + 5 * p.mu / 6
        # k/2 (J - a)² less its value at rest, with k (a - 1) = 3/4 m
        volume = bulk(k, J - 1) - 3 * shear / 4 * (J - 1)
        return shear / 2 * (I1 - 3) + volume - shear / 2 * m.log((I1 + 1) / 4)

    def mixed_density(self, I1: Any, I2: Any, J: Any, pressure: Any, p: Any, m: Any) -> Any:
        """See MixedLaw; l is positive already."""
        return self.density(I1, I2, J, p, m, by_pressure(pressure))
