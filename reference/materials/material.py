"""What all laws have in common: parameters checked when made, and the scale of their stiffness at rest."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import TypeVar

from ...lhm.base.errors import SceneError

L = TypeVar("L", bound="LameLaw")


@dataclass(frozen=True)
class Material(ABC):
    """A hyperelastic law; stresses and moduli in kPa."""

    @property
    def name(self) -> str:
        """The law's class name, by which errors and reports call it."""
        return type(self).__name__

    @property
    @abstractmethod
    def stiffness(self) -> float:
        """The scale of the tangent at rest [kPa]."""

    @property
    def resists_volume_change(self) -> bool:
        """Whether the law has a volumetric part; one without it is for Incompressible only."""
        return True


@dataclass(frozen=True)
class Isotropic(Material):
    """A law whose tangent at rest is that of isotropic elasticity."""

    @property
    @abstractmethod
    def lame(self) -> tuple[float, float]:
        """Lamé's mu and lmbda of the tangent at rest [kPa]."""

    @property
    def stiffness(self) -> float:
        """See Material: 2 mu + |lmbda|."""
        mu, lmbda = self.lame
        return 2 * mu + abs(lmbda)


@dataclass(frozen=True)
class LameLaw(Isotropic):
    """An isotropic law whose parameters are Lamé's mu and lmbda [kPa]; SceneError unless mu > 0, lmbda > -2/3 mu."""

    mu: float
    lmbda: float

    def __post_init__(self):
        lame_parameters(self, self.mu, self.lmbda)

    @classmethod
    def from_young(cls: type[L], young: float, poisson: float) -> L:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        return cls(*lame(young, poisson))

    @property
    def lame(self) -> tuple[float, float]:
        """See Isotropic."""
        return self.mu, self.lmbda


def finite(value: object) -> bool:
    """Whether a value is one finite number."""
    return isinstance(value, Real) and isfinite(value)


def lame(young: float, poisson: float) -> tuple[float, float]:
    """Lamé's mu and lmbda [the unit of young] of Young's modulus and Poisson's ratio in (-1, 0.5)."""
    if not (finite(young) and young > 0):
        raise SceneError(f"Young's modulus must be positive and finite, got {young}")
    if not (finite(poisson) and -1 < poisson < 0.5):
        raise SceneError(f"Poisson's ratio must lie in (-1, 0.5) for a displacement element, got {poisson}")
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def positive(law: Material, *names: str):
    """Raise SceneError for the first of a law's parameters that is not positive and finite."""
    for name in names:
        value = getattr(law, name)
        if not (finite(value) and value > 0):
            raise SceneError(f"{law.name}: {name} must be positive and finite, got {value}")


def not_negative(law: Material, *names: str):
    """Raise SceneError for the first of a law's parameters that is negative or not finite."""
    for name in names:
        value = getattr(law, name)
        if not (finite(value) and value >= 0):
            raise SceneError(f"{law.name}: {name} must be at least 0 and finite, got {value}")


def optional_bulk(law: Material, kappa: float | None):
    """Raise SceneError for a bulk modulus [kPa] that is given and not positive and finite."""
    if kappa is not None and not (finite(kappa) and kappa > 0):
        raise SceneError(f"{law.name}: kappa must be positive and finite, got {kappa}")


def lame_parameters(law: Material, mu: float, lmbda: float):
    """Raise SceneError unless mu and lmbda [kPa] give a law positive shear and bulk moduli."""
    if not (finite(mu) and mu > 0):
        raise SceneError(f"{law.name}: mu must be positive and finite, got {mu}")
    if not (finite(lmbda) and lmbda > -2 / 3 * mu):
        raise SceneError(f"{law.name}: lmbda must exceed -2/3 mu and be finite, got {lmbda}")
