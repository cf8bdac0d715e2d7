"""One call of solve: what is asked, and what all attempts at it have found and spent together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from ..clock import Seconds
from ..scene import Scene
from ..solution import Limits, OnIteration, Reason, Recorder, Solution, Stresses, least_quadratic_ratio, volume_ratio
from .mesh.numbering import Numbering
from .mesh.parallel import anywhere


@dataclass(frozen=True, eq=False)
class Attempt:
    """Where a strategy ended, and why: displacement [mm] and pressure [kPa] by node of a numbering, energy [µJ]."""

    reason: Reason
    numbering: Numbering
    u: Floats
    pressure: Floats | None
    energy: float


class Record:
    """Count the cost of all attempts, and call the caller's `on_iteration`.

    `limit` are the iterations that the caller allows, None for each strategy's own; `detail` is `Solution.detail`.
    """

    def __init__(self, limit: int | None, on_iteration: OnIteration | None):
        self.recorder, self.limit = Recorder(on_iteration), limit
        self.has_listener = on_iteration is not None
        self.iterations = 0
        self.detail: Counter[str] = Counter()

    def left(self, most: int) -> int:
        """Give the iterations that a strategy may make, which by itself would make `most`."""
        return most if self.limit is None else self.limit - self.iterations

    def add(self, iterations: int, **counts: float):
        """Count what an attempt has cost."""
        self.iterations += iterations
        self.detail.update(counts)


class Run:
    """A scene to be solved on a numbering, from start [mm], shape (scene vertices, 3), and its record.

    `held` says which components of nodes (n, 3) keep their place. `u` is the displacement [mm] by node at the start;
    `goal` is the one that held components have to reach. `is_given` says whether the caller gave the start.
    """

    def __init__(
        self,
        scene: Scene,
        numbering: Numbering,
        start: Floats,
        limits: Limits,
        record: Record,
        *,
        is_given: bool = False,
    ):
        self.scene, self.numbering, self.limits, self.record = scene, numbering, limits, record
        self.start, self.is_given = start, is_given
        self._held, self._places = held, positions = scene.dirichlet()
        self._elsewhere = np.where(held, positions, start)
        self.held = numbering.held(held)
        self.u = numbering.to_dofs(start) - numbering.X
        self.goal = np.where(self.held, numbering.to_dofs(positions) - numbering.X, self.u)
        self._has_listener = anywhere(numbering.comm, record.has_listener)

    def restart(self, start: Floats) -> Run:
        """Give the same run from elsewhere."""
        return Run(self.scene, self.numbering, start, self.limits, self.record)

    def threshold(self, first: float) -> float:
        """Give the gradient norm [mN] at which to stop, from the first one."""
        return self.limits.threshold(self.scene, first)

    def report(self, u: Floats, energy: float, norm: float) -> bool:
        """Record an iteration; whether any rank's caller asks to stop."""
        positions = self._positions(u) if self._has_listener else u
        return anywhere(self.numbering.comm, self.record.recorder.record(positions, energy, norm))

    def _positions(self, u: Floats) -> Floats:
        return self.numbering.to_scene(self.numbering.X + u, self._elsewhere)

    def solution(self, end: Attempt, preparation: Seconds, recovery: Callable[[], Stresses] | None = None) -> Solution:
        """Give an attempt's answer, after so many seconds of preparation."""
        numbering = self.numbering
        positions = self._positions(end.u)
        history = self.record.recorder.history()
        last = history.gradient_norm[-1] if len(history.gradient_norm) else np.inf
        reason = end.reason.at_rounding(self.scene, float(last))
        if reason in (Reason.CONVERGED, Reason.ROUNDING):
            positions[self._held] = self._places[self._held]
        ratio, least = volume_ratio(self.scene, positions), None
        if numbering.degree == 2:
            ends, nodes = numbering.all_nodes(numbering.X + end.u)
            least = least_quadratic_ratio(self.scene, positions, ends, nodes)
        record = self.record
        return Solution(
            positions,
            reason.if_inverted(self.scene, (ratio if least is None else least) <= 0.0),
            record.iterations,
            end.energy,
            history,
            ratio,
            dict(record.detail),
            recovery=recovery,
            least_ratio=least,
            times=record.recorder.times(preparation),
        )
