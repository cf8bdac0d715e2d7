"""Frames of a take in their order, each with its error: by a certified face, or by the simulator, one after another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..lhm.base.errors import SoftdecaError
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.expressions import Take, rotations
from ..reference import Sequence, SettledFace, Solution
from ..reference.face.dynamics import extrapolate_turns
from ..reference.face.sequence import TOLERANCE, State
from ..reference.face.settle import carry_skin
from ..surrogate.certified import POLICY, CertifiedFace, Reached, find_counted
from .play import blend_linearly

TIGHTER, TIGHTEST = 0.1, 1e-9
"""A frame of the simulator that is not within the accuracy goes on to this times its tolerance, down to the least."""


@dataclass(frozen=True, eq=False)
class TakeFrame:
    """A frame: its skin (n, 3) [mm], its fields of the log, and the state from which the next one follows.

    Fields: method, error [mm] (None: not known), certain, solves, reason ("" where nothing failed), and, of the
    simulator, energy [µJ], residual (gradient norm [mN]), inverted tets and contacts.
    """

    skin: Floats | Floats32
    record: dict[str, Any]
    state: dict[str, np.ndarray]


class TakeFrames(Protocol):
    """Makes a take's frames in their order."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of a state's arrays."""
        ...

    def resume(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on after the frame that left a state."""
        ...

    def frame(self, number: int) -> TakeFrame:
        """Make frame `number`, which follows the last one made."""
        ...


class CertifiedFrames:
    """Static frames within an accuracy [mm], each by the cheapest method; see `surrogate.certified`."""

    state_names: tuple[str, ...] = ("weights", "positions")

    def __init__(self, face: CertifiedFace, take: Take, accuracy: float):
        self._face, self._take, self._accuracy = face, take, accuracy
        self._last: Reached | None = None

    def resume(self, state: Mapping[str, np.ndarray]) -> None:
        """See TakeFrames."""
        self._last = Reached(state["weights"], state["positions"])

    def frame(self, number: int) -> TakeFrame:
        """See TakeFrames."""
        made = self._face.frame(self._take.weights[number], self._accuracy, after=self._last)
        self._last = made
        reason = "" if made.bound <= self._accuracy else f"error {made.bound:.2g} mm, expected {self._accuracy:g}"
        record = {"method": made.method, "error": made.error, "certain": made.certain, "solves": made.solves}
        state = {"weights": made.weights, "positions": made.positions}
        return TakeFrame(made.skin, record | {"reason": reason}, state)


class SimulatedFrames:
    """Frames of a sequence of the simulator, with inertia, contact or bones of one's own; each within an accuracy [mm].

    The error of a frame with inertia is to the converged answer that follows the frames before as they were made.
    """

    state_names: tuple[str, ...] = ("positions", "sought", "before", "drift", "turns")

    def __init__(
        self, neutral: SettledFace, deltas: Floats, take: Take, accuracy: float, *, dynamic: bool, contact: bool
    ):
        self._sequence = Sequence.from_face(neutral, time_step=1.0 / take.rate, dynamic=dynamic)
        self._neutral, self._deltas, self._take = neutral, deltas, take
        self._accuracy, self._has_contact = accuracy, contact
        self._carried = carry_skin(neutral.head, neutral.parameters)
        turned = dynamic and take.head is not None
        self._bases = rotations(take.head) if turned else np.array([np.eye(3)] * len(take.times))

    def resume(self, state: Mapping[str, np.ndarray]) -> None:
        """See TakeFrames."""
        self._sequence.state = State(**state)

    def frame(self, number: int) -> TakeFrame:
        """See TakeFrames. SoftdecaError where the first frame fails, for there is nothing to begin from."""
        expression = blend_linearly(self._neutral.head.skin, self._deltas, self._take.weights[number])
        skin, record = self._solve(expression, self._bases[number:])
        state = self._sequence.state
        if state is None:
            raise SoftdecaError(f"frame {number}: {record['reason']}; nothing to begin from")
        return TakeFrame(skin, record, {name: getattr(state, name) for name in self.state_names})

    def _solve(self, expression: Floats, bases: Floats) -> tuple[Floats, dict[str, Any]]:
        sequence, tolerance = self._sequence, TOLERANCE
        try:
            if sequence.recurrence is not None and sequence.state is None:
                sequence.begin(expression, base=extrapolate_turns(bases))
            solution = sequence.frame(expression, base=bases[0])
            if not np.isfinite(solution.positions).all():
                return self._neutral.targets(expression), _record(solution.reason.name, solution)
            error, certain = self._estimate(expression, solution)
            while (
                error is not None
                and error * (1.0 if certain else POLICY.doubt) > self._accuracy
                and solution.converged
                and tolerance > TIGHTEST
            ):
                tolerance *= TIGHTER
                solution = sequence.refine(tolerance)
                error, certain = self._estimate(expression, solution)
        except SoftdecaError as failure:
            return self._neutral.targets(expression), _record(str(failure))
        reason = "" if solution.converged else solution.reason.name
        if not reason and error is not None and error > self._accuracy:
            reason = f"error {error:.2g} mm, expected {self._accuracy:g}"
        record = _record(reason, solution) | {"error": error, "certain": certain}
        return sequence.skin(expression, solution), record

    def _estimate(self, expression: Floats, solution: Solution) -> tuple[float | None, bool]:
        """Return a frame's error [mm], and whether it is certain; None where surfaces in contact hide it."""
        estimate = None if self._has_contact else self._sequence.estimate_left()
        if estimate is None:
            return None, False
        left, certain = estimate
        counted = find_counted(self._sequence.skin(expression, solution) + left, expression + self._carried)
        return float(np.linalg.norm(left, axis=1)[counted].mean()), certain


def _record(reason: str, solution: Solution | None = None) -> dict[str, Any]:
    """Return what the log has of a solution; None where there is none."""
    row: dict[str, Any] = {"method": "simulated", "error": None, "certain": False, "solves": 0, "reason": reason}
    row |= dict.fromkeys(("energy", "residual", "inverted", "contacts_before", "contacts"))
    if solution is not None:
        row["solves"] = solution.iterations
        row["energy"] = _number(solution.energy)
        row["residual"] = _number(solution.history.gradient_norm[-1])
        row["inverted"] = int(np.count_nonzero(solution.volume_ratio <= 0.0))
        row["contacts_before"] = _number(solution.detail.get("contact_pairs_before"))
        row["contacts"] = _number(solution.detail.get("contact_pairs_after"))
    return row


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None
