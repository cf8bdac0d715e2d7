"""Sixteen consecutive frames with inertia, begun with a velocity of one long run of the corpus (SoftDECA 3.4)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...lhm.base.errors import InputError, SoftdecaError
from ...lhm.base.files.npz import read_arrays, write_arrays
from ...lhm.base.mesh import Floats
from ...lhm.base.progress import OnProgress, silent
from ...lhm.expressions import Take, conversation, rotations
from ...lhm.head import LayeredHead
from ...reference import Parameters, Sequence, settle
from ...reference.face.dynamics import extrapolate_turns
from ...reference.face.sequence import Velocities, is_plausible
from .people import People, Person
from .plan import LENGTH, RATE, VELOCITIES, CorpusPlan
from .shard import ACCEPTED
from .simulator import Answer, FaceSimulator

RUN = "velocities.npz"
RUN_TOLERANCE = 5e-4
"""Of the run: what its velocities are good for are starts that nobody has measured."""


@dataclass(frozen=True, eq=False)
class Rolled:
    """A sequence, as `shard.Sequences` has it, without the first axis."""

    weights: Floats
    rotations: Floats
    before: Floats
    corrected: np.ndarray
    status: str
    iterations: np.ndarray
    residual: np.ndarray
    smallest_volume_ratio: np.ndarray
    inverted: np.ndarray
    crossings: np.ndarray

    @classmethod
    def failed(cls, status: str, take: Take, first: int, n: int) -> Rolled:
        """A sequence that there is none of."""
        none = np.zeros(LENGTH)
        motion = np.zeros((LENGTH, n, 3), dtype=np.float16)
        weights, turned = _driven(take, first)
        return cls(weights, turned, np.zeros((2, n, 3)), motion, status, none, none, none, none, none)


def rolled(
    plan: CorpusPlan, face: FaceSimulator, take: Take, first: int, velocities: Velocities, rng: np.random.Generator
) -> Rolled:
    """Simulate the frames from `first` on, begun with a random one of the velocities; a failure is a status."""
    n = len(face.person.skin.vertices)
    weights, turned = _driven(take, first)
    try:
        velocity = _velocity(face.head, velocities, rng)
        running = Sequence.from_face(face.neutral, time_step=1.0 / RATE, dynamic=True, tolerance=plan.tolerance)
        expressions = [face.expression(w) for w in weights]
        begun = running.begin(expressions[0], velocity=velocity, base=extrapolate_turns(turned))
        at_rest = face.corrected(weights[0], begun.positions)
        frames = zip(weights, expressions, turned, strict=True)
        answers = [face.answer(w, running.frame(expression, base=base)) for w, expression, base in frames]
    except SoftdecaError as error:
        return Rolled.failed(f"sequence: {error}", take, first, n)
    return Rolled(
        weights=weights,
        rotations=turned,
        before=np.stack([at_rest, at_rest - velocity / RATE]),
        corrected=np.stack([one.corrected for one in answers]),
        status=_status(answers),
        iterations=np.array([one.iterations for one in answers]),
        residual=np.array([one.residual for one in answers]),
        smallest_volume_ratio=np.array([one.smallest_volume_ratio for one in answers]),
        inverted=np.array([one.inverted for one in answers]),
        crossings=np.array([one.crossings for one in answers]),
    )


def _velocity(head: LayeredHead, velocities: Velocities, rng: np.random.Generator) -> Floats:
    """One of the plausible velocities [mm/s], shape (n, 3); none of a hundred is none."""
    for _ in range(100):
        velocity = velocities.on(head, int(rng.integers(len(velocities))))
        if is_plausible(velocity, 1.0 / RATE):
            return velocity
    return np.zeros(head.skin.vertices.shape)


def _driven(take: Take, first: int) -> tuple[Floats, Floats]:
    """Weights and head rotations of a sequence's frames."""
    part = take.part(slice(first, first + LENGTH))
    turned = np.tile(np.eye(3), (LENGTH, 1, 1)) if part.head is None else rotations(part.head)
    return part.weights.astype(np.float32), turned


def _status(answers: list[Answer]) -> str:
    bad = [(k, one.status) for k, one in enumerate(answers) if one.status != ACCEPTED]
    return f"frame {bad[0][0]}: {bad[0][1]}" if bad else ACCEPTED


def velocities_of(folder: Path, plan: CorpusPlan, people: People, *, on_progress: OnProgress = silent) -> Velocities:
    """The velocities of a run of `plan.run` frames of made-up conversation on the plan's first person, default p.

    Kept in the corpus' folder; made anew where the file is missing, damaged or of another plan.
    """
    path = folder / RUN
    owner = f"{plan.digest}-{people.name}"
    try:
        arrays = read_arrays(path, "local", "owner", "checksum", of="the velocities of a corpus")
        if str(arrays["owner"]) == owner and str(arrays["checksum"]) == _checksum(arrays["local"]):
            return Velocities(arrays["local"].astype(np.float32))
    except InputError:
        pass
    local = _run(plan, people, on_progress).local.astype(np.float16)
    write_arrays(path, {"local": local, "owner": np.array(owner), "checksum": np.array(_checksum(local))})
    return Velocities(local.astype(np.float32))


def _checksum(local: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(local).tobytes()).hexdigest()


def _run(plan: CorpusPlan, people: People, on_progress: OnProgress) -> Velocities:
    person = people.person(plan.rng(VELOCITIES))
    weights = conversation(plan.rng(VELOCITIES, 1), plan.run, rate=RATE)
    running = Sequence.from_face(
        settle(people.head(person), Parameters()), time_step=1.0 / RATE, dynamic=True, tolerance=RUN_TOLERANCE
    )

    def expressions():
        for number, w in enumerate(weights):
            yield _expression(person, w)
            on_progress(f"a long run: frame {number + 1} of {plan.run}", (number + 1) / plan.run)

    return Velocities.from_sequence(running, expressions())


def _expression(person: Person, weights: np.ndarray) -> np.ndarray:
    return person.skin.vertices + np.tensordot(weights, person.shapes, axes=1)
