"""The way down to a minimiser: Newton's method, where tets are inverted first on an energy that leads out of that."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...lhm.base.mesh import Floats
from ..scene import Scene
from ..solution import Limits, Reason, Recorder
from .discretisation import Discretisation
from .energy import Energy
from .newton import OnStep, Scales, minimise
from .unknowns import Unknowns
from .untangling import is_tangled, without_volume

UNTANGLED = 1e-5  # of the first gradient norm
MAX_UNTANGLING = 100


@dataclass(eq=False)
class Descent:
    """What one solve goes down by, and the recorder it tells of every iteration, once."""

    scene: Scene
    at: Discretisation
    energy: Energy
    unknowns: Unknowns
    scales: Scales
    recorder: Recorder
    _told: Floats | None = field(default=None, init=False)
    _stop: bool = field(default=False, init=False)

    def run(self, x: Floats, *, forces: float, limits: Limits, limit: int) -> tuple[Floats, Reason, int]:
        """Minimise from positions by dof [mm]; give where it ends, why, and the iterations made, at most `limit`.

        A tolerance relates to the larger of the first gradient norm and `forces` [mN].
        """
        if not np.isfinite(self.energy.value(x)):
            self._tell(x, np.inf, np.inf)
            return x, Reason.NOT_FINITE, 0
        made = 0
        if is_tangled(self.scene, self.at, x):
            forces = max(forces, self._norm(x))
            x, reason, made = self._minimise(
                Energy(without_volume(self.scene), self.at),
                x,
                lambda first: UNTANGLED * first,
                min(limit, MAX_UNTANGLING),
                lambda x, value, norm: self._tell(x, self.energy.value(x), self._norm(x)),
            )
            if reason is Reason.INTERRUPTED:
                return x, reason, made

        def threshold(first: float) -> float:
            return limits.threshold(self.scene, max(first, forces))

        x, reason, more = self._minimise(self.energy, x, threshold, limit - made, self._tell)
        return x, reason, made + more

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
        )

    def _norm(self, x: Floats) -> float:
        return float(np.linalg.norm(self.unknowns.gradient(x, self.energy.gradient(x))))

    def _tell(self, x: Floats, value: float, norm: float) -> bool:
        """Record an iteration; that which ends one descent begins the next, and is told once."""
        if x is not self._told:
            self._told, self._stop = x, self.recorder.record(x[self.at.vertex_dofs], value, norm)
        return self._stop
