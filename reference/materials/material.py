"""The bases of hyperelastic laws.

A law is one file of this folder: a frozen dataclass of its parameters [kPa], checked when made, with its energy density
by the three invariants. FEniCSx derives compiled code from the formula, scikit-fem takes its derivatives by complex
steps, so that one solver checks the other; closed forms and values of other codes check the formula.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import Any, ClassVar, TypeVar

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats

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
    def shear_modulus(self) -> float:
        """The scale of the resistance to a change of shape [kPa]."""
        return self.stiffness

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

    @property
    def shear_modulus(self) -> float:
        return self.lame[0]


@dataclass(frozen=True)
class EnergyLaw(Isotropic):
    """An isotropic law by one formula, from which each solver takes its derivatives; what a file of one's own adds.

    FEniCSx and scikit-fem model it. Projective dynamics has no use for laws.
    """

    finite_inverted: ClassVar[bool] = False
    """Whether the energy is finite for J <= 0. Where it is not, solvers must refuse to start from inverted tets."""

    @abstractmethod
    def density(self, I1: Any, I2: Any, J: Any, p: Any, m: Any) -> Any:
        """Psi [kPa] of I1 = tr C, I2 = (tr²C - tr C²)/2 and J = det F, C being FᵀF; no number where it does not hold.

        The invariants and the law's fields, p.mu and so on, may be numbers, arrays, also complex ones, and symbols of
        UFL or of compiled code. m has their functions by numpy's names: log, exp, sqrt, sin, cos, tanh, arctan, where.
        """

    def energy(self, invariants: Floats) -> Floats:
        """Return psi [kPa], shape (m,), of invariants (3, m); infinite where the law does not hold."""
        with np.errstate(all="ignore"):
            psi = self.density(invariants[0], invariants[1], invariants[2], self, np)
        return np.where(np.isfinite(psi), psi, np.inf)

    def slopes(self, invariants: Floats) -> Floats:
        """Return psi's derivatives by invariants [kPa], both (3, m), by complex steps, which are exact to rounding."""
        by_each = []
        for step in 1e-30j * np.eye(3)[:, :, None]:
            I1, I2, J = invariants + step
            by_each.append(self.density(I1, I2, J, self, np).imag / 1e-30)
        return np.stack(by_each)


@dataclass(frozen=True)
class MixedLaw(EnergyLaw):
    """A law that FEniCSx models on mixed elements, too, whose pressure [kPa] is independent.

    A volumetric part U(J) is replaced by pressure (J - 1) - U*(pressure) with U* its Legendre transform, or kappa/2 g²
    by pressure g - pressure²/(2 kappa). Stationary in the pressure, they give the law back. Both stay finite as the
    bulk modulus grows (Sussman and Bathe 1987, "A finite element formulation for nonlinear incompressible elastic and
    inelastic analysis").
    """

    @abstractmethod
    def mixed_density(self, I1: Any, I2: Any, J: Any, pressure: Any, p: Any, m: Any) -> Any:
        """Psi [kPa] of the invariants and the pressure."""

    def check_mixed(self):
        """Raise SceneError for parameters that the mixed density does not hold for."""


@dataclass(frozen=True)
class LameLaw(Isotropic):
    """An isotropic law whose parameters are Lamé's mu and lmbda [kPa]; SceneError unless mu > 0, lmbda > -2/3 mu."""

    mu: float
    lmbda: float

    def __post_init__(self):
        check_lame(self, self.mu, self.lmbda)

    @classmethod
    def from_young(cls: type[L], young: float, poisson: float) -> L:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        return cls(*lame(young, poisson))

    @property
    def lame(self) -> tuple[float, float]:
        return self.mu, self.lmbda


def lame(young: float, poisson: float) -> tuple[float, float]:
    """Lamé's mu and lmbda [the unit of young] of Young's modulus and Poisson's ratio in (-1, 0.5)."""
    if not (is_finite(young) and young > 0):
        raise SceneError(f"Young's modulus must be positive and finite, got {young}")
    if not (is_finite(poisson) and -1 < poisson < 0.5):
        raise SceneError(f"Poisson's ratio must lie in (-1, 0.5) for a displacement element, got {poisson}")
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def is_finite(value: object) -> bool:
    """Whether a value is one finite number."""
    return isinstance(value, Real) and isfinite(value)


def check_positive(law: Material, *names: str):
    """Raise SceneError for the first of a law's parameters that is not positive and finite."""
    for name in names:
        value = getattr(law, name)
        if not (is_finite(value) and value > 0):
            raise SceneError(f"{law.name}: {name} must be positive and finite, got {value}")


def check_not_negative(law: Material, *names: str):
    """Raise SceneError for the first of a law's parameters that is negative or not finite."""
    for name in names:
        value = getattr(law, name)
        if not (is_finite(value) and value >= 0):
            raise SceneError(f"{law.name}: {name} must be at least 0 and finite, got {value}")


def check_lame(law: Material, mu: float, lmbda: float):
    """Raise SceneError unless mu and lmbda [kPa] give a law positive shear and bulk moduli."""
    if not (is_finite(mu) and mu > 0):
        raise SceneError(f"{law.name}: mu must be positive and finite, got {mu}")
    if not (is_finite(lmbda) and lmbda > -2 / 3 * mu):
        raise SceneError(f"{law.name}: lmbda must exceed -2/3 mu and be finite, got {lmbda}")
