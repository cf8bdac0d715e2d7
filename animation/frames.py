"""Frames of a take in their order: by a certified face, by the simulator, one after another, or by a rig alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..lhm.base.errors import SoftdecaError
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.base.progress import describe_duration
from ..lhm.expressions import Take, rotations
from ..reference import Sequence, Solution
from ..reference.face.dynamics import extrapolate_turns
from ..reference.face.sequence import TOLERANCE
from ..surrogate import BoundRig
from ..surrogate.certified import POLICY, CertifiedFace, find_counted

SURVEYED = 12
"""Frames of a take by which its price is foreseen."""
TIGHTER, TIGHTEST = 0.1, 1e-9
"""A frame of the simulator that is not within the accuracy goes on to this times its tolerance, down to the least."""


Frame = tuple[Floats | Floats32, dict[str, Any]]
"""A frame's skin (n, 3) [mm], and its fields of the log.

Fields: method, error [mm] (None: not known), certain, solves (not of a rig), reason ("" where nothing failed), and,
of the simulator, energy [µJ], residual (gradient norm [mN]), inverted tets, contacts and crossing triangles.
"""


def rig_frames(method: str, rig: BoundRig, take: Take, dynamic: bool) -> Iterator[Frame]:
    """Make a take's frames by a rig, which tells no error; with inertia if `dynamic`."""
    record = {"method": method, "error": None, "certain": False, "reason": ""}
    if not dynamic:
        yield from ((rig.frame(weights), record) for weights in take.weights)
        return
    bases = None if take.head is None else rotations(take.head)
    moving = rig.dynamic(1.0 / take.rate)
    if bases is not None:
        moving.begin(take.weights[0], base=extrapolate_turns(bases))
    for number, weights in enumerate(take.weights):
        yield moving.frame(weights, base=None if bases is None else bases[number]), record


def foresee(face: CertifiedFace, take: Take, accuracy: float) -> str:
    """Say how many frames of a take need contact solved for, and how long all take: by SURVEYED frames of it."""
    count, surveyed = len(take.times), np.unique(np.linspace(0, len(take.times) - 1, SURVEYED).astype(int))
    touching = np.array([face.touches(take.weights[k].astype(np.float64)) for k in surveyed])
    seconds = 0.0
    for kind in (surveyed[touching], surveyed[~touching]):
        if len(kind):
            k = kind[len(kind) // 2]
            before = face.frame(take.weights[max(k - 1, 0)], accuracy)
            frame = face.frame(take.weights[k], accuracy, after=before)
            seconds += frame.seconds * count * len(kind) / len(surveyed)
    share = (
        f"about {touching.mean():.0%} of {count} touch, and are simulated" if touching.any() else f"{count}, corrected"
    )
    return f"frames: {share}; some {describe_duration(seconds)}"


def certified_frames(face: CertifiedFace, take: Take, accuracy: float) -> Iterator[Frame]:
    """Make static frames within an accuracy [mm], each by the cheapest method; see `surrogate.certified`."""
    last = None
    for weights in take.weights:
        last = face.frame(weights, accuracy, after=last)
        reason = "" if last.bound <= accuracy else f"error {last.bound:.2g} mm, expected {accuracy:g}"
        record = {"method": last.method, "error": last.error, "certain": last.certain, "solves": last.solves}
        yield last.skin, record | {"reason": reason}


def simulated_frames(sequence: Sequence, take: Take, accuracy: float) -> Iterator[Frame]:
    """Simulate a take's frames in their order, with inertia, contact or bones of one's own; within an accuracy [mm].

    The error of a frame with inertia is to the converged answer that follows the frames before as they were made.
    SoftdecaError where the first frame fails, for there is nothing to begin from.
    """
    turned = sequence.recurrence is not None and take.head is not None
    bases = rotations(take.head) if turned else np.array([np.eye(3)] * len(take.times))
    for number, weights in enumerate(take.weights):
        skin, record = _simulate(sequence, sequence.face.blend(weights), bases[number:], accuracy)
        if sequence.state is None:
            raise SoftdecaError(f"frame {number}: {record['reason']}; nothing to begin from")
        yield skin, record


def _simulate(sequence: Sequence, expression: Floats, bases: Floats, accuracy: float) -> Frame:
    """Simulate one frame, more closely until it is within the accuracy; `bases` (k, 3, 3): of it and what follows."""
    tolerance = TOLERANCE
    try:
        if sequence.recurrence is not None and sequence.state is None:
            sequence.begin(expression, base=extrapolate_turns(bases))
        solution = sequence.frame(expression, base=bases[0])
        if not np.isfinite(solution.positions).all():
            return sequence.face.settled().targets(expression), _record(solution.reason.name, solution)
        error, certain = _estimate(sequence, expression, solution)
        while error * (1.0 if certain else POLICY.doubt) > accuracy and solution.converged and tolerance > TIGHTEST:
            tolerance *= TIGHTER
            solution = sequence.refine(tolerance)
            error, certain = _estimate(sequence, expression, solution)
    except SoftdecaError as failure:
        return sequence.face.settled().targets(expression), _record(str(failure))
    reason = "" if solution.converged else solution.reason.name
    if not reason and error > accuracy:
        reason = f"error {error:.2g} mm, expected {accuracy:g}"
    return sequence.skin(expression, solution), _record(reason, solution) | {"error": error, "certain": certain}


def _estimate(sequence: Sequence, expression: Floats, solution: Solution) -> tuple[float, bool]:
    """Return a frame's error [mm], and whether it is certain."""
    estimate = sequence.estimate_left()
    assert estimate is not None  # the simulator is projective dynamics
    left, certain = estimate
    counted = find_counted(sequence.skin(expression, solution) + left, expression + sequence.face.carried)
    return float(np.linalg.norm(left, axis=1)[counted].mean()), certain


def _record(reason: str, solution: Solution | None = None) -> dict[str, Any]:
    """Return what the log has of a solution; None where there is none."""
    row: dict[str, Any] = {"method": "simulated", "error": None, "certain": False, "solves": 0, "reason": reason}
    row |= dict.fromkeys(("energy", "residual", "inverted", "contacts", "crossings"))
    if solution is not None:
        row["solves"] = solution.iterations
        row["energy"] = _number(solution.energy)
        row["residual"] = _number(solution.history.gradient_norm[-1])
        row["inverted"] = int(np.count_nonzero(solution.volume_ratio <= 0.0))
        row["contacts"] = _number(solution.detail.get("contact_pairs"))
        row["crossings"] = _number(solution.detail.get("contact_crossings"))
    return row


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None
