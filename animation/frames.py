"""Frames of a take in their order: by a certified face, by the simulator, one after another, or by a rig alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..lhm.base.errors import SoftdecaError
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.expressions import Take, rotations
from ..reference import Face, Sequence, Solution
from ..reference.face.dynamics import extrapolate_turns
from ..reference.face.sequence import TOLERANCE
from ..surrogate import BoundRig
from ..surrogate.certified import POLICY, CertifiedFace, find_counted

TIGHTER, TIGHTEST = 0.1, 1e-9
"""A frame of the simulator that is not within the accuracy goes on to this times its tolerance, down to the least."""


@dataclass(frozen=True, eq=False)
class TakeFrame:
    """A frame: its skin (n, 3) [mm], and its fields of the log.

    Fields: method, error [mm] (None: not known), certain, solves (not of a rig), reason ("" where nothing failed), and,
    of the simulator, energy [µJ], residual (gradient norm [mN]), inverted tets and contacts.
    """

    skin: Floats | Floats32
    record: dict[str, Any]


def blend_linearly(neutral: Surface, deltas: Floats, weights: Floats) -> Floats:
    """Linear blendshapes [mm], shape (n, 3), of weights (52,)."""
    used = np.flatnonzero(weights)
    return neutral.vertices + np.tensordot(weights[used], deltas[used], axes=1)


def rig_frames(method: str, rig: BoundRig, take: Take, dynamic: bool) -> Iterator[TakeFrame]:
    """Make a take's frames by a rig, which tells no error; with inertia if `dynamic`."""
    record = {"method": method, "error": None, "certain": False, "reason": ""}
    if not dynamic:
        yield from (TakeFrame(rig.frame(weights), record) for weights in take.weights)
        return
    bases = None if take.head is None else rotations(take.head)
    moving = rig.dynamic(1.0 / take.rate)
    if bases is not None:
        moving.begin(take.weights[0], base=extrapolate_turns(bases))
    for number, weights in enumerate(take.weights):
        yield TakeFrame(moving.frame(weights, base=None if bases is None else bases[number]), record)


def certified_frames(face: CertifiedFace, take: Take, accuracy: float) -> Iterator[TakeFrame]:
    """Make static frames within an accuracy [mm], each by the cheapest method; see `surrogate.certified`."""
    last = None
    for weights in take.weights:
        last = face.frame(weights, accuracy, after=last)
        reason = "" if last.bound <= accuracy else f"error {last.bound:.2g} mm, expected {accuracy:g}"
        record = {"method": last.method, "error": last.error, "certain": last.certain, "solves": last.solves}
        yield TakeFrame(last.skin, record | {"reason": reason})


class SimulatedFrames:
    """Frames of a sequence of the simulator, with inertia, contact or bones of one's own; each within an accuracy [mm].

    The error of a frame with inertia is to the converged answer that follows the frames before as they were made.
    Iterating raises SoftdecaError where the first frame fails, for there is nothing to begin from.
    """

    def __init__(self, face: Face, take: Take, accuracy: float, *, dynamic: bool):
        self._sequence = Sequence(face, time_step=1.0 / take.rate, dynamic=dynamic)
        self._face, self._take, self._accuracy = face, take, accuracy
        turned = dynamic and take.head is not None
        self._bases = rotations(take.head) if turned else np.array([np.eye(3)] * len(take.times))

    def __iter__(self) -> Iterator[TakeFrame]:
        for number, weights in enumerate(self._take.weights):
            expression = blend_linearly(self._face.skin, self._face.shapes, weights)
            skin, record = self._solve(expression, self._bases[number:])
            if self._sequence.state is None:
                raise SoftdecaError(f"frame {number}: {record['reason']}; nothing to begin from")
            yield TakeFrame(skin, record)

    def _solve(self, expression: Floats, bases: Floats) -> tuple[Floats, dict[str, Any]]:
        sequence, tolerance = self._sequence, TOLERANCE
        try:
            if sequence.recurrence is not None and sequence.state is None:
                sequence.begin(expression, base=extrapolate_turns(bases))
            solution = sequence.frame(expression, base=bases[0])
            if not np.isfinite(solution.positions).all():
                return self._face.settled().targets(expression), _record(solution.reason.name, solution)
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
            return self._face.settled().targets(expression), _record(str(failure))
        reason = "" if solution.converged else solution.reason.name
        if not reason and error is not None and error > self._accuracy:
            reason = f"error {error:.2g} mm, expected {self._accuracy:g}"
        record = _record(reason, solution) | {"error": error, "certain": certain}
        return sequence.skin(expression, solution), record

    def _estimate(self, expression: Floats, solution: Solution) -> tuple[float | None, bool]:
        """Return a frame's error [mm], and whether it is certain; None where surfaces in contact hide it."""
        estimate = None if self._face.choices.get("contact") else self._sequence.estimate_left()
        if estimate is None:
            return None, False
        correction, certain = estimate
        counted = find_counted(self._sequence.skin(expression, solution) + correction, expression + self._face.carried)
        return float(np.linalg.norm(correction, axis=1)[counted].mean()), certain


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
