"""The corotated law: linear elasticity in the rotated frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from .material import LameLaw


@dataclass(frozen=True)
class Corotated(LameLaw):
    """psi = mu ‖F - R‖² + lmbda/2 tr²(S - I), F = R S with a rotation R; mu and lmbda [kPa].

    Chao, Pinkall, Sanan, Schröder 2010, "A Simple Geometric Model for Elastic Deformations". Finite for every F: an
    inverted one has a negative principal stretch. Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """

    def by_stretches(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasStretches: mu Σ(s - 1)² + lmbda/2 (Σ(s - 1))²."""
        strain = s - 1.0
        trace = strain.sum(axis=1)
        psi = self.mu * np.sum(strain**2, axis=1) + 0.5 * self.lmbda * trace**2
        h = np.tile(2.0 * self.mu * np.eye(3) + self.lmbda, (len(s), 1, 1))
        return psi, 2.0 * self.mu * strain + (self.lmbda * trace)[:, None], h

    def by_rotation(self, d: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasRotation."""
        gradient = np.column_stack([np.full(len(t), self.mu), self.lmbda * t])
        return self.mu * d + self.lmbda / 2 * t**2, gradient, np.tile(np.diag([0.0, self.lmbda]), (len(t), 1, 1))
