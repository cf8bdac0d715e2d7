"""The energy of a change of volume, and laws that are the sum of an isochoric and a volumetric part."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from enum import Enum
from typing import Any

import numpy as np

from ...lhm.base.mesh import Floats
from .material import EnergyLaw, Material, check_positive

POWERS = np.array([-2 / 3, -4 / 3])
"""Powers of J that turn I1 and I2 into the isochoric invariants i1 and i2."""


class Volumetric(str, Enum):
    """The energy U(J) of a change of volume, by its formula; kappa is the bulk modulus [kPa]."""

    QUADRATIC = "kappa/2 (J-1)^2"
    LOGARITHMIC = "kappa/4 (J^2-1-2 ln J)"

    def __str__(self) -> str:
        return self.value

    def density(self, J, kappa):
        """U [kPa] in UFL."""
        import ufl

        if self is Volumetric.LOGARITHMIC:
            return kappa / 4 * (J**2 - 1 - 2 * ufl.ln(J))
        return kappa / 2 * (J - 1) ** 2

    def complementary(self, pressure, kappa):
        """U*(pressure) [kPa] in UFL; of the logarithmic U, U'(J) = kappa/2 (J - 1/J) = pressure gives J."""
        import ufl

        if self is Volumetric.LOGARITHMIC:
            q = pressure / kappa
            J = q + ufl.sqrt(1 + q**2)
            return pressure * (J - 1) - self.density(J, kappa)
        return pressure**2 / (2 * kappa)

    def derivatives(self, J: Floats, kappa: float) -> tuple[Floats, Floats, Floats | float]:
        """U, U' and U'' [kPa] by hand, at J > 0 of shape (m,)."""
        if self is Volumetric.QUADRATIC:
            return kappa / 2 * (J - 1) ** 2, kappa * (J - 1), kappa
        k = kappa / 2
        return k / 2 * (J**2 - 1 - 2 * np.log(J)), k * (J - 1 / J), k * (1 + 1 / J**2)


class SplitLaw(Material):
    """A law of an isochoric part of J^(-1/3) F, and a volumetric part that is absent without kappa [kPa]."""

    kappa: float | None
    volumetric = Volumetric.QUADRATIC

    @property
    def resists_volume_change(self) -> bool:
        """See Material."""
        return self.kappa is not None

    @staticmethod
    @abstractmethod
    def isochoric(F: Any, p: Any) -> Any:
        """See HasMixedDensity."""

    def density(self, F: Any, p: Any) -> Any:
        """See HasDensity."""
        import ufl

        return self.isochoric(F, p) + self.volumetric.density(ufl.det(F), p.kappa)

    def mixed_density(self, F: Any, pressure: Any, p: Any) -> Any:
        """See HasMixedDensity."""
        import ufl

        complementary = self.volumetric.complementary(pressure, p.kappa)
        return self.isochoric(F, p) + pressure * (ufl.det(F) - 1) - complementary

    def check_mixed(self):
        """See HasMixedDensity; kappa is positive already."""

    def check_kappa(self):
        """Raise SceneError for a bulk modulus that is given and not positive and finite."""
        if self.kappa is not None:
            check_positive(self, "kappa")


class SplitInvariantLaw(SplitLaw, EnergyLaw):
    """A SplitLaw whose isochoric part is a function of i1 = J^(-2/3) I1 and i2 = J^(-4/3) I2."""

    @abstractmethod
    def by_isochoric(self, i1: Floats, i2: Floats) -> tuple[Floats, Floats, Floats]:
        """The isochoric part (m,), its gradient (m, 2) and Hessian (m, 2, 2) by i1 and i2 [kPa]."""

    def by_invariants(self, I1: Floats, I2: Floats, J: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasInvariants; infinite for J <= 0."""
        holds, J = J > 0, np.where(J > 0, J, 1.0)
        scales = J[:, None] ** POWERS
        i = scales * np.stack([I1, I2], axis=1)
        psi, by_i, by_ii = self.by_isochoric(i[:, 0], i[:, 1])
        U, dU, ddU = self.volumetric.derivatives(J, self.kappa or 0.0)
        change = np.zeros((len(J), 2, 3))  # of i by (I1, I2, J)
        change[:, 0, 0], change[:, 1, 1] = scales.T
        change[:, :, 2] = POWERS * i / J[:, None]
        gradient = np.einsum("mk,mka->ma", by_i, change)
        gradient[:, 2] += dU
        hessian = change.transpose(0, 2, 1) @ by_ii @ change
        mixed = by_i * POWERS * scales / J[:, None]
        hessian[:, :2, 2] += mixed
        hessian[:, 2, :2] += mixed
        hessian[:, 2, 2] += np.sum(by_i * POWERS * (POWERS - 1) * i, axis=1) / J**2 + ddU
        return np.where(holds, psi + U, np.inf), gradient, hessian


Bulk = Callable[[Any, Any], Any]
"""The bulk part of a density in UFL, from its modulus [kPa] and a measure g of the change of volume."""


def quadratic(modulus, g):
    """The bulk part modulus/2 g² of a law in UFL."""
    return modulus / 2 * g**2


def by_pressure(pressure) -> Bulk:
    """The bulk part pressure g - pressure²/(2 modulus), in place of modulus/2 g²."""
    return lambda modulus, g: pressure * g - pressure**2 / (2 * modulus)
