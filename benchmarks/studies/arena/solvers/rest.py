"""The one rule by which dynamics comes to rest: where the kinetic energy falls, every velocity becomes zero."""

from __future__ import annotations

import numpy as np

from .protocol import Floats

RAMP = 20
"""Steps or frames in which a prescribed motion is done."""


class KineticDamping:
    """Says after each step whether velocities are to be set to zero (Barnes 1999, "Form finding and analysis")."""

    def __init__(self, masses: Floats):
        self._masses, self._last = masses, 0.0

    def stops(self, velocities: Floats) -> bool:
        """Say whether the kinetic energy of velocities (n, 3) is below that of the step before."""
        energy = float(self._masses @ np.einsum("ij,ij->i", velocities, velocities))
        falls = energy < self._last
        self._last = 0.0 if falls else energy
        return falls


def ramp(step: int, steps: int) -> float:
    """Give the share of a prescribed motion after so many of `steps` steps."""
    return min(1.0, (step + 1) / max(steps, 1))
