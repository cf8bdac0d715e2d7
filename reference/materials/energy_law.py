"""A law that brings its energy along: what a file of one's own adds."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from ...lhm.base.mesh import Floats
from .material import Isotropic


@dataclass(frozen=True)
class EnergyLaw(Isotropic):
    """A law in one class: its parameters are numbers, and it writes its energy twice, so that one checks the other.

    FEniCSx takes `density`, and derives it; scikit-fem takes `by_invariants`, derived by hand. Projective dynamics and
    mixed elements have no use for either, and refuse it by name.
    """

    finite_inverted = False
    """Whether the energy is finite for J <= 0; solvers must refuse to start there where it is not."""

    @staticmethod
    @abstractmethod
    def density(F: Any, p: Any) -> Any:
        """Psi [kPa] in UFL, of the deformation gradient and the law's fields as symbols, p.mu and so on."""

    @abstractmethod
    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """Psi (m,), its gradient (m, 3) and Hessian (m, 3, 3) by the invariants I1, I2 of FᵀF and J = det F [kPa].

        psi is infinite where the law does not hold; the derivatives there are not looked at.
        """
