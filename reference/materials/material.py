"""The base of all hyperelastic laws, and the forms in which a law gives its energy to solvers.

A law is one file of this folder: a frozen dataclass of its parameters [kPa], checked when made, with its energy density
written twice or more. FEniCSx derives stress and tangent from the density in UFL; scikit-fem takes derivatives by hand.
Neither form is computed from another, so that one solver checks the other. A solver refuses by name a law that lacks
the form it needs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

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


@runtime_checkable
class HasDensity(Protocol):
    """A law that FEniCSx models on displacement elements."""

    def density(self, F: Any, p: Any) -> Any:
        """Psi [kPa] in UFL, of the deformation gradient and the law's fields as symbols, p.mu and so on."""
        ...


@runtime_checkable
class HasMixedDensity(Protocol):
    """A law that FEniCSx models on mixed elements, whose pressure [kPa] is independent.

    A volumetric part U(J) is replaced by pressure (J - 1) - U*(pressure) with U* its Legendre transform, or kappa/2 g²
    by pressure g - pressure²/(2 kappa). Stationary in the pressure, they give the law back. Both stay finite as the
    bulk modulus grows (Sussman and Bathe 1987, "A finite element formulation for nonlinear incompressible elastic and
    inelastic analysis").
    """

    def mixed_density(self, F: Any, pressure: Any, p: Any) -> Any:
        """Psi [kPa] in UFL, of F, the pressure and the law's fields."""
        ...

    def isochoric(self, F: Any, p: Any) -> Any:
        """The part [kPa] in UFL that Incompressible keeps: psi where J = 1, as a function of J^(-1/3) F."""
        ...

    def check_mixed(self) -> None:
        """Raise SceneError for parameters that the mixed density does not hold for."""
        ...


@runtime_checkable
class HasStretches(Protocol):
    """A law that FEniCSx models on displacement elements though UFL cannot write it as a function of F."""

    def by_stretches(self, s: Sequence[Any], p: Any) -> Any:
        """Psi [kPa] in UFL, of three signed singular values of F and the law's fields as symbols."""
        ...


@runtime_checkable
class HasInvariants(Protocol):
    """A law that scikit-fem models, by hand."""

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """Psi (m,), its gradient (m, 3) and Hessian (m, 3, 3) [kPa] by I1 = tr C, I2 = (tr²C - tr C²)/2, J = det F.

        C is FᵀF. psi is infinite where the law does not hold; the derivatives there are not used.
        """
        ...


@runtime_checkable
class HasRotation(Protocol):
    """A law that scikit-fem models, by hand, by the rotation R nearest to F."""

    def by_rotation(self, d: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Psi (m,), its gradient (m, 2) and Hessian (m, 2, 2) [kPa] by d = ‖F - R‖² and t = tr S - 3, F = R S."""
        ...


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
        """See Material."""
        return self.lame[0]


@dataclass(frozen=True)
class EnergyLaw(Isotropic):
    """An isotropic law with the two forms that FEniCSx and scikit-fem need; what a file of one's own adds.

    With a mixed density too, mixed elements model it. Projective dynamics has no use for laws.
    """

    finite_inverted: ClassVar[bool] = False
    """Whether the energy is finite for J <= 0. Where it is not, solvers must refuse to start from inverted tets."""

    @staticmethod
    @abstractmethod
    def density(F: Any, p: Any) -> Any:
        """See HasDensity."""

    @abstractmethod
    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasInvariants."""


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
        """See Isotropic."""
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
