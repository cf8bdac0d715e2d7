"""Hyperelastic laws as parameters [kPa]; each solver writes the energy itself, so that one can check the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lhm.errors import SceneError


def lame(young: float, poisson: float) -> tuple[float, float]:
    """Lamé's mu and lmbda [the unit of young] of Young's modulus and Poisson's ratio in (-1, 0.5)."""
    if not young > 0:
        raise SceneError(f"Young's modulus must be positive, got {young}")
    if not -1 < poisson < 0.5:
        raise SceneError(f"Poisson's ratio must lie in (-1, 0.5) for a displacement element, got {poisson}")
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


@dataclass(frozen=True)
class NeoHookean:
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J (Bonet and Wood 2008, Eq. 6.27); mu and lmbda [kPa]."""

    mu: float
    lmbda: float

    def __post_init__(self):
        if not (np.isfinite(self.mu) and self.mu > 0):
            raise SceneError(f"NeoHookean: mu must be positive and finite, got {self.mu}")
        if not (np.isfinite(self.lmbda) and self.lmbda > -2 / 3 * self.mu):
            raise SceneError(f"NeoHookean: lmbda must exceed -2/3 mu and be finite, got {self.lmbda}")

    @classmethod
    def from_young(cls, young: float, poisson: float) -> NeoHookean:
        """The law whose small-strain moduli are Young's modulus [kPa] and Poisson's ratio."""
        return cls(*lame(young, poisson))


Material = NeoHookean
