"""The energy of a change of volume, and laws that are the sum of an isochoric and a volumetric part."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from enum import Enum
from typing import Any

from .material import MixedLaw, check_positive


class Volumetric(str, Enum):
    """The energy U(J) of a change of volume, by its formula; kappa is the bulk modulus [kPa]."""

    QUADRATIC = "kappa/2 (J-1)^2"
    LOGARITHMIC = "kappa/4 (J^2-1-2 ln J)"

    def __str__(self) -> str:
        return self.value

    def density(self, J: Any, kappa: Any, m: Any) -> Any:
        """Return U [kPa]; m is EnergyLaw's."""
        if self is Volumetric.LOGARITHMIC:
            return kappa / 4 * (J**2 - 1 - 2 * m.log(J))
        return kappa / 2 * (J - 1) ** 2

    def complementary(self, pressure: Any, kappa: Any, m: Any) -> Any:
        """Return U*(pressure) [kPa]; of the logarithmic U, U'(J) = kappa/2 (J - 1/J) = pressure gives J."""
        if self is Volumetric.LOGARITHMIC:
            q = pressure / kappa
            J = q + m.sqrt(1 + q**2)
            return pressure * (J - 1) - self.density(J, kappa, m)
        return pressure**2 / (2 * kappa)


class SplitLaw(MixedLaw):
    """A law of i1 = J^(-2/3) I1 and i2 = J^(-4/3) I2, and a volumetric part that is absent without kappa [kPa]."""

    kappa: float | None
    volumetric = Volumetric.QUADRATIC

    @property
    def resists_volume_change(self) -> bool:
        return self.kappa is not None

    @abstractmethod
    def isochoric(self, i1: Any, i2: Any, p: Any) -> Any:
        """Return the isochoric part [kPa]."""

    def density(self, I1: Any, I2: Any, J: Any, p: Any, m: Any) -> Any:
        shape = self.isochoric(J ** (-2 / 3) * I1, J ** (-4 / 3) * I2, p)
        return shape if self.kappa is None else shape + self.volumetric.density(J, p.kappa, m)

    def mixed_density(self, I1: Any, I2: Any, J: Any, pressure: Any, p: Any, m: Any) -> Any:
        shape = self.isochoric(J ** (-2 / 3) * I1, J ** (-4 / 3) * I2, p)
        return shape + pressure * (J - 1) - self.volumetric.complementary(pressure, p.kappa, m)

    def check_kappa(self):
        """Raise SceneError for a bulk modulus that is given and not positive and finite."""
        if self.kappa is not None:
            check_positive(self, "kappa")


Bulk = Callable[[Any, Any], Any]
"""The bulk part of a density, from its modulus [kPa] and a measure g of the change of volume."""


def quadratic(modulus: Any, g: Any) -> Any:
    """Return the bulk part modulus/2 g² of a law."""
    return modulus / 2 * g**2


def by_pressure(pressure: Any) -> Bulk:
    """Return the bulk part pressure g - pressure²/(2 modulus), in place of modulus/2 g²."""
    return lambda modulus, g: pressure * g - pressure**2 / (2 * modulus)
