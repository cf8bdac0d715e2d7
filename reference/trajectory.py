"""What a march through time returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..lhm.base.mesh import Floats, Ints
from .solution import Reason


@dataclass(frozen=True, eq=False)
class Energies:
    """Energies at each time [µJ], shape (k + 1,); the first two are states, the others sums since the start.

    `dissipated` is the work of viscous damping, `input` that of moving targets, held vertices and an accelerated frame;
    that of loads and sought volumes which change with time is not counted.
    kinetic + potential + dissipated - input stays as it is but for what the scheme loses (or gains).
    """

    kinetic: Floats
    potential: Floats
    dissipated: Floats
    input: Floats

    @property
    def balance(self) -> Floats:
        """What the scheme adds: kinetic + potential + dissipated - input, less its first value [µJ], shape (k + 1,)."""
        total = self.kinetic + self.potential + self.dissipated - self.input
        return total - total[0]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The steps made, and why the march ended: CONVERGED if all were made, else what ended the last one.

    time_step [s]; times [s], shape (k + 1,), from the start; positions [mm] and velocities [mm/s] of the kept
    vertices, shape (k + 1, kept, 3); `vertices` (kept,) are their numbers; iterations (k,) and factorisations (k,) per
    step. A step that failed is not among them.
    """

    time_step: float
    times: Floats
    positions: Floats
    velocities: Floats
    vertices: Ints
    energies: Energies
    iterations: Ints
    factorisations: Ints
    reason: Reason

    @property
    def converged(self) -> bool:
        """Whether every step reached its tolerance."""
        return self.reason is Reason.CONVERGED


OnStep = Callable[[int, float, Floats], "bool | None"]
"""Called with step, time [s] and positions [mm], shape (scene's vertices, 3); returning True ends the march."""
