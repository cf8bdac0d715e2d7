"""The compressible neo-Hookean law with a logarithmic volumetric part."""

from __future__ import annotations

from dataclasses import dataclass

from .material import Isotropic, lame, lame_parameters


@dataclass(frozen=True)
class NeoHookean(Isotropic):
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J (Bonet and Wood 2008, Eq. 6.27); mu and lmbda [kPa].

    Infinite for J <= 0. Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    mu: float
    lmbda: float

    def __post_init__(self):
        lame_parameters(self, self.mu, self.lmbda)

    @classmethod
    def from_young(cls, young: float, poisson: float) -> NeoHookean:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        return cls(*lame(young, poisson))

    @property
    def lame(self) -> tuple[float, float]:
        """See Isotropic."""
        return self.mu, self.lmbda
