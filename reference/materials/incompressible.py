"""A law made incompressible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...lhm.base.errors import SceneError
from .material import EnergyLaw, Material


@dataclass(frozen=True)
class Incompressible(Material):
    """The isochoric part of a law, with J = 1 enforced by the pressure of a mixed element; `law`'s kappa is not used.

    Displacement elements refuse it by name. Raises SceneError for what is no law by invariants, or is incompressible
    already.
    """

    law: EnergyLaw

    def __post_init__(self):
        if not isinstance(self.law, EnergyLaw):
            raise SceneError(f"{self.name}: expected a compressible law by invariants, got {type(self.law).__name__}")

    @property
    def stiffness(self) -> float:
        return self.law.stiffness

    @property
    def shear_modulus(self) -> float:
        return self.law.shear_modulus

    def mixed_density(self, I1: Any, I2: Any, J: Any, pressure: Any, p: Any, m: Any) -> Any:
        """See MixedLaw; p has the fields of the law, whose energy is that of J^(-1/3) F."""
        return self.law.density(J ** (-2 / 3) * I1, J ** (-4 / 3) * I2, 1.0, p, m) + pressure * (J - 1)
