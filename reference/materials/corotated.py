"""The corotated law: linear elasticity in the rotated frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...lhm.base.mesh import Floats
from .material import LameLaw


@dataclass(frozen=True)
class Corotated(LameLaw):
    """psi = mu ‖F - R‖² + lmbda/2 tr²(S - I), F = R S with a rotation R; mu and lmbda [kPa].

    Chao, Pinkall, Sanan, Schröder 2010, "A Simple Geometric Model for Elastic Deformations". Finite for every F: an
    inverted one has a negative principal stretch. Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    def by_stretches(self, s: Sequence[Any], p: Any) -> Any:
        """Return psi [kPa] of three signed singular values of F and the law's fields as symbols, for FEniCSx."""
        trace = s[0] + s[1] + s[2] - 3
        return p.mu * sum((value - 1) ** 2 for value in s) + p.lmbda / 2 * trace**2

    def by_rotation(self, d: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Return psi (m,), its gradient (m, 2) and Hessian (m, 2, 2) [kPa] by d = ‖F - R‖² and t = tr S - 3, F = R S.

        scikit-fem takes this form. Neither is computed from the other.
        """
        gradient = np.column_stack([np.full(len(t), self.mu), self.lmbda * t])
        return self.mu * d + self.lmbda / 2 * t**2, gradient, np.tile(np.diag([0.0, self.lmbda]), (len(t), 1, 1))
