"""The way down to a minimiser by Newton's method.

Surfaces in contact meet a wide barrier before the narrow one. First of all, held vertices are moved to their places
without crushing the elements next to them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...lhm.base.mesh import Floats
from ..scene import Scene
from ..solution import Limits, Reason, Recorder
from .discretisation import Discretisation
from .energy import Energy
from .newton import OnStep, Scales, minimise, solve_semidefinite
from .policy import POLICY, SkfemPolicy
from .unknowns import Unknowns


@dataclass(eq=False)
class Descent:
    """One solve: an energy, its unknowns, and the recorder, which is told of every iteration once."""

    scene: Scene
    discretisation: Discretisation
    energy: Energy
    unknowns: Unknowns
    scales: Scales
    recorder: Recorder
    policy: SkfemPolicy = POLICY
    _recorded: Floats | None = field(default=None, init=False)
    _stop: bool = field(default=False, init=False)

    def run(self, x: Floats, *, forces: float, limits: Limits, limit: int) -> tuple[Floats, Reason, int]:
        """Minimise from positions by dof [mm]; give where it ends, why, and the iterations made, at most `limit`.

        A tolerance relates to the larger of the first gradient norm and `forces` [mN].
        """
        if not np.isfinite(self.energy.value(x)):
            self._record(x, np.inf, np.inf)
            return x, Reason.NOT_FINITE, 0
        iterations = 0
        if (wide := self.energy.widen()) is not None:
            forces = max(forces, self._norm(x))
            met = max(self.policy.descent.met * forces, limits.threshold(self.scene, forces))
            x, reason, more = self._minimise(wide, x, lambda first: met, limit - iterations, self._record_true)
            iterations += more
            if reason is Reason.INTERRUPTED:
                return x, reason, iterations

        def threshold(first: float) -> float:
            return limits.threshold(self.scene, max(first, forces))

        x, reason, more = self._minimise(self.energy, x, threshold, limit - iterations, self._record)
        return x, reason, iterations + more

    def _minimise(
        self, energy: Energy, x: Floats, threshold, limit: int, on_step: OnStep
    ) -> tuple[Floats, Reason, int]:
        return minimise(
            energy,
            x,
            self.unknowns,
            scales=self.scales,
            threshold=threshold,
            max_iterations=limit,
            on_step=on_step,
            policy=self.policy.newton,
        )

    def _norm(self, x: Floats) -> float:
        return float(np.linalg.norm(self.unknowns.gradient(x, self.energy.gradient(x))))

    def _record_true(self, x: Floats, value: float, norm: float) -> bool:
        """Record an iteration on another energy by the values of this one."""
        return self._record(x, self.energy.value(x), self._norm(x))

    def _record(self, x: Floats, value: float, norm: float) -> bool:
        """Record an iteration. The point between two descents is recorded once."""
        if x is not self._recorded:
            self._recorded, self._stop = x, self.recorder.record(x[self.discretisation.vertex_dofs], value, norm)
        return self._stop


def carry(
    energy: Energy, x: Floats, goal: Floats, *, free: np.ndarray, scales: Scales, policy: SkfemPolicy = POLICY
) -> tuple[Floats, float] | None:
    """Move the degrees of freedom that are not `free`, a mask, from x, of finite energy, to `goal` [mm], shape (size,).

    The free ones follow as the body linearised at x would. Where the energy is not finite after the whole motion, the
    largest of its halves, quarters, ... that keeps it finite is made first; the free vertices relax before the next.
    Returns positions of finite energy and the norm [mN] of the forces that the motion causes while nothing follows;
    None if there is no such way.
    """
    held, free = np.flatnonzero(~free), np.flatnonzero(free)
    forces = 0.0
    while True:
        jump = goal[held] - x[held]
        if not jump.any():
            return x, forces
        matrix = energy.projected_hessian(x)[free]
        load = matrix[:, held] @ jump
        forces = max(forces, float(np.linalg.norm(load)))
        following = solve_semidefinite(matrix[:, free], -load, scale=scales.stiffness, shifts=policy.newton.shifts)
        if following is None:
            return None
        whole = goal.copy()
        whole[free] = x[free] + following
        part = _largest_finite_part(energy, x, whole, policy.descent.smallest_part)
        if part == 1.0:
            return whole, forces
        if part == 0.0:
            return None
        x, _, _ = minimise(
            energy,
            x + part * (whole - x),
            Unknowns(free, len(x), []),
            scales=scales,
            threshold=lambda first: policy.descent.relaxed * first,
            max_iterations=policy.descent.relaxing_iterations,
            on_step=lambda x, value, norm: False,
            policy=policy.newton,
        )


def _largest_finite_part(energy: Energy, x: Floats, whole: Floats, smallest: float) -> float:
    """1, 1/2, 1/4, ...: the largest part of the motion from x that leaves the energy finite; 0 below `smallest`."""
    part = 1.0
    while part >= smallest:
        if np.isfinite(energy.value_ahead(x, x + part * (whole - x) if part < 1 else whole)):
            return part
        part /= 2
    return 0.0
