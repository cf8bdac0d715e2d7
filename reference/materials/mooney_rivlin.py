"""The Mooney-Rivlin law with a quadratic term in the first invariant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...lhm.base.errors import SceneError
from .material import check_not_negative
from .volumetric import SplitLaw


@dataclass(frozen=True)
class MooneyRivlin(SplitLaw):
    """psi = C10 (i1 - 3) + C01 (i2 - 3) + C20 (i1 - 3)² + kappa/2 (J - 1)², i1 = J^(-2/3) I1, i2 = J^(-4/3) I2.

    C10, C01, C20 and the bulk modulus kappa [kPa]; the shear modulus at rest is 2 (C10 + C01). Infinite for J <= 0.
    Without kappa the law is for Incompressible only. Mooney 1940, "A Theory of Large Elastic Deformation"; with C20
    the reduced polynomial of Yeoh 1993. Raises SceneError for a negative parameter, or C10 and C01 both 0.
    """

    C10: float
    C01: float
    kappa: float | None = None
    C20: float = 0.0

    def __post_init__(self):
        check_not_negative(self, "C10", "C01", "C20")
        if self.C10 + self.C01 <= 0:
            raise SceneError(f"{self.name}: C10 + C01 must be positive, got {self.C10 + self.C01}")
        self.check_kappa()

    @property
    def lame(self) -> tuple[float, float]:
        """See Isotropic; without kappa, of the isochoric part."""
        mu = 2 * (self.C10 + self.C01)
        return mu, (self.kappa or 0.0) - 2 / 3 * mu

    def isochoric(self, i1: Any, i2: Any, p: Any) -> Any:
        return p.C10 * (i1 - 3) + p.C01 * (i2 - 3) + p.C20 * (i1 - 3) ** 2
