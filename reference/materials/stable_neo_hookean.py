"""The stable neo-Hookean law, which is finite and smooth through inversion."""

from __future__ import annotations

from dataclasses import dataclass

from .material import Isotropic, lame, lame_parameters


@dataclass(frozen=True)
class StableNeoHookean(Isotropic):
    """psi = m/2 (I1 - 3) + l/2 (J - a)² - m/2 ln(I1 + 1) up to a constant, m = 4/3 mu, l = lmbda + 5/6 mu.

    a = 1 + m/l - m/(4 l) makes rest free of stress; m and l make mu and lmbda [kPa] the moduli there (Smith, de Goes,
    Kim 2018, "Stable Neo-Hookean Flesh Simulation", Section 3.4). Finite for every F.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    mu: float
    lmbda: float

    def __post_init__(self):
        lame_parameters(self, self.mu, self.lmbda)

    @classmethod
    def from_young(cls, young: float, poisson: float) -> StableNeoHookean:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        return cls(*lame(young, poisson))

    @property
    def lame(self) -> tuple[float, float]:
        """See Isotropic."""
        return self.mu, self.lmbda
