"""A cheek that is drawn aside and let go, and a head that is shaken: by Eq. 9, by PD with mass on the skin, by FEM."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from ....lhm.base.mesh import Floats, Ints
from ....reference import (
    Face,
    Reason,
    Scene,
    Sequence,
    Solution,
    march,
    solve,
)
from ....reference.face.dynamics import Recurrence
from ....reference.face.sequence import State

DRAWN, REACH = 5.0, 25.0  # mm down at the cheek, and the standard deviation of what follows it
FRAME = 1.0 / 60.0
REACHED = (Reason.CONVERGED, Reason.STAGNATED)  # at this tolerance rounding may end a frame that begins near its answer
FEWEST = 4  # values of a motion, beyond which a damped cosine of four unknowns is fitted to it
TIGHT, FINE = 1e-9, 1e-6  # tolerances where solvers are compared, and where time steps are


@dataclass(frozen=True)
class Swing:
    """A damped cosine fitted to a motion: frequency [Hz], damping ratio, and the misfit's RMS over the first value.

    None where the motion was too short to fit one.
    """

    frequency: float | None
    damping: float | None
    misfit: float | None


def swing(times: Floats, motion: Floats) -> Swing:
    """Fit e^(-ζωt) (A cos ω_d t + B sin ω_d t) to a motion (k,) at times [s], evenly spaced."""

    def miss(rates: Floats) -> Floats:
        omega, decay = rates
        waves = np.exp(-decay * times)[:, None] * np.column_stack([np.cos(omega * times), np.sin(omega * times)])
        return waves @ np.linalg.lstsq(waves, motion, rcond=None)[0] - motion

    guesses = 2.0 * np.pi / times[-1] * np.array([0.5, 1.0, 1.5, 2.0, 3.0, 5.0])
    # Beyond half the rate of the values there is another ω for each, which fits as well.
    fastest = np.pi / (times[1] - times[0])
    bounds = ([0.0, -np.inf], [fastest, np.inf])
    fits = [least_squares(miss, [guess, 0.1 * guess], bounds=bounds) for guess in guesses if guess < fastest]
    best = min(fits, key=lambda fit: fit.cost)
    omega, decay = best.x
    natural = float(np.hypot(omega, decay))
    return Swing(natural / (2.0 * np.pi), decay / natural, float(np.sqrt(np.mean(best.fun**2)) / abs(motion[0])))


@dataclass(frozen=True, eq=False)
class Frames:
    """A motion in steps of `time_step` [s]: positions [mm], shape (k + 1, n, 3), and iterations per step, (k,).

    `reason` is why the step after the last failed; of a whole motion it is CONVERGED.
    """

    time_step: float
    positions: Floats
    iterations: Ints
    reason: Reason

    @property
    def converged(self) -> bool:
        """Whether every frame was made."""
        return self.reason is Reason.CONVERGED


@dataclass(frozen=True, eq=False)
class Release:
    """A face at rest in its neutral pose, bones held, and the same with the skin around a `vertex` drawn aside.

    `areal` [kg/mm²] is the mass per skin area that makes Eq. 9 of p's springs swing at p's frequency.
    """

    face: Face = field(repr=False)
    vertex: int
    scene: Scene = field(init=False, repr=False)
    start: Floats = field(init=False, repr=False)
    sought: Floats = field(init=False, repr=False)
    areal: float = field(init=False)

    def __post_init__(self):
        head, p = self.face.head, self.face.parameters
        skin, wrap = head.skin.vertices, head.skin_wrap.vertices
        near = np.exp(-np.sum((skin - wrap[self.vertex]) ** 2, axis=1) / (2.0 * REACH**2))
        drawn = head.wrap_targets(skin + DRAWN * near[:, None] * [0.0, -1.0, 0.0])
        scene = self.face.neutral_scene()
        areal = float(np.mean(p.target_stiffness)) / (2.0 * np.pi * p.frequency) ** 2
        start = solve(scene.with_targets(drawn), solver="fenicsx", tolerance=TIGHT).positions
        for name, value in (("scene", scene), ("start", start), ("sought", drawn), ("areal", areal)):
            object.__setattr__(self, name, value)

    def motion(self, positions: Floats) -> Floats:
        """Measure the share of the skin wrap's first displacement that is left, (k,), of positions (k, n, 3) [mm]."""
        rest = self.scene.vertices[: len(self.face.head.bone)]
        first = self.start[: len(rest)] - rest
        return np.einsum("kni,ni->k", positions - rest, first) / np.sum(first**2)

    def play_recurrence(self, recurrence: Recurrence, frames: int) -> Frames:
        """March frames of Eq. 9 through projective dynamics, the start first."""
        neutral = self.face.head.skin.vertices
        sequence = Sequence(self.face, time_step=FRAME, dynamic=True, tolerance=TIGHT)
        sequence.recurrence = recurrence
        sequence.state = State(self.start, self.sought, self.start[: len(self.face.head.bone)])
        return self._collect(FRAME, self.start, (sequence.frame(neutral) for _ in range(frames)), REACHED)

    def play(
        self,
        scheme: str,
        frames: int,
        per_frame: int = 1,
        *,
        solver: str = "fenicsx",
        tolerance: float = FINE,
        shaken: Callable[[float], Floats] | None = None,
    ) -> Frames:
        """March the motion with mass on the skin, `per_frame` steps a frame; shaken is the head's acceleration [mm/s²].

        Let go from the start, or shaken from rest.
        """
        time_step = FRAME / per_frame
        moments = march(
            self.scene,
            solver=solver,
            time_step=time_step,
            steps=frames * per_frame,
            scheme=scheme,
            skin=self.face.head.skin_wrap.triangles,
            skin_density=self.areal,
            positions=self.start if shaken is None else None,
            acceleration=shaken,
            tolerance=tolerance,
        )
        start = next(moments).positions
        return self._collect(time_step, start, (moment.solution for moment in moments), (Reason.CONVERGED,))

    def _collect(
        self, time_step: float, start: Floats, solutions: Iterable[Solution], reached: tuple[Reason, ...]
    ) -> Frames:
        """Keep the skin wrap's places, up to the first solution that ended for a reason that is not `reached`."""
        n = len(self.face.head.bone)
        places, iterations, reason = [start[:n]], [], Reason.CONVERGED
        for solution in solutions:
            if solution.reason not in reached:
                reason = solution.reason
                break
            places.append(solution.positions[:n])
            iterations.append(solution.iterations)
        return Frames(time_step, np.stack(places), np.array(iterations), reason)
