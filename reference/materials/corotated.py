"""The corotated law: linear elasticity in the rotated frame."""

from __future__ import annotations

from dataclasses import dataclass

from .material import Isotropic, lame, lame_parameters


@dataclass(frozen=True)
class Corotated(Isotropic):
    """psi = mu ‖F - R‖² + lmbda/2 tr²(S - I), F = R S with a rotation R; mu and lmbda [kPa].

    Chao, Pinkall, Sanan, Schröder 2010, "A Simple Geometric Model for Elastic Deformations". Finite for every F: an
    inverted one has a negative principal stretch. Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    mu: float
    lmbda: float

    def __post_init__(self):
        lame_parameters(self, self.mu, self.lmbda)

    @classmethod
    def from_young(cls, young: float, poisson: float) -> Corotated:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        return cls(*lame(young, poisson))

    @property
    def lame(self) -> tuple[float, float]:
        """See Isotropic."""
        return self.mu, self.lmbda
