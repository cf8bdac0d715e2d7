"""The St. Venant-Kirchhoff law: linear elasticity in Green's strain."""

from __future__ import annotations

from dataclasses import dataclass

from .material import Isotropic, lame, lame_parameters


@dataclass(frozen=True)
class StVenantKirchhoff(Isotropic):
    """psi = mu tr E² + lmbda/2 tr²E, E = (FᵀF - I)/2 (Bonet and Wood 2008, Eq. 6.25); mu and lmbda [kPa].

    For small strains only: it softens under compression and does not see inversion, F and -F cost the same.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    mu: float
    lmbda: float

    def __post_init__(self):
        lame_parameters(self, self.mu, self.lmbda)

    @classmethod
    def from_young(cls, young: float, poisson: float) -> StVenantKirchhoff:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        return cls(*lame(young, poisson))

    @property
    def lame(self) -> tuple[float, float]:
        """See Isotropic."""
        return self.mu, self.lmbda
