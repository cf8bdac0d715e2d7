"""A law made incompressible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...lhm.base.errors import SceneError
from .material import HasMixedDensity, Material


@dataclass(frozen=True)
class Incompressible(Material):
    """The isochoric part of a law, with J = 1 enforced by the pressure of a mixed element; `law`'s kappa is not used.

    Displacement elements refuse it by name. Raises SceneError for what is no law, or is incompressible already.
    """

    law: Material

    def __post_init__(self):
        if not isinstance(self.law, Material) or isinstance(self.law, Incompressible):
            raise SceneError(f"{self.name}: expected a compressible law, got {type(self.law).__name__}")

    @property
    def stiffness(self) -> float:
        """See Material."""
        return self.law.stiffness

    @property
    def shear_modulus(self) -> float:
        """See Material."""
        return self.law.shear_modulus

    def mixed_density(self, F: Any, pressure: Any, p: Any) -> Any:
        """See HasMixedDensity; p has the fields of the law."""
        import ufl

        assert isinstance(self.law, HasMixedDensity)
        return self.law.isochoric(F, p) + pressure * (ufl.det(F) - 1)
