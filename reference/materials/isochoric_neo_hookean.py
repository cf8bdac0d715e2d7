"""The neo-Hookean law in its isochoric form, with the volumetric part that it names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...lhm.base.errors import SceneError
from .material import check_positive, lame
from .volumetric import SplitLaw, Volumetric


@dataclass(frozen=True)
class IsochoricNeoHookean(SplitLaw):
    """psi = mu/2 (J^(-2/3) I1 - 3) plus the volumetric part; mu and bulk modulus kappa [kPa].

    `volumetric` is a Volumetric or its formula: "kappa/2 (J-1)^2", or "kappa/4 (J^2-1-2 ln J)" (Miehe 1994, "Aspects
    of the formulation and finite element implementation of large strain isotropic elasticity"). Infinite for J <= 0.
    Without kappa the law is for Incompressible only. Raises SceneError for a modulus that is not positive, or another
    formula.
    """

    mu: float
    kappa: float | None = None
    volumetric: Volumetric = Volumetric.QUADRATIC

    def __post_init__(self):
        check_positive(self, "mu")
        self.check_kappa()
        try:
            object.__setattr__(self, "volumetric", Volumetric(self.volumetric))
        except ValueError:
            names = " or ".join(f"{law.value!r}" for law in Volumetric)
            raise SceneError(f"{self.name}: volumetric must be {names}, got {self.volumetric!r}") from None

    @classmethod
    def from_young(
        cls, young: float, poisson: float, volumetric: Volumetric = Volumetric.QUADRATIC
    ) -> IsochoricNeoHookean:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        mu, lmbda = lame(young, poisson)
        return cls(mu, lmbda + 2 / 3 * mu, volumetric)

    @property
    def lame(self) -> tuple[float, float]:
        """See Isotropic; without kappa, of the isochoric part."""
        return self.mu, (self.kappa or 0.0) - 2 / 3 * self.mu

    def isochoric(self, i1: Any, i2: Any, p: Any) -> Any:
        return p.mu / 2 * (i1 - 3)
