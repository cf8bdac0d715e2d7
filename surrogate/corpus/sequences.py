"""Sixteen consecutive frames with inertia, begun with a velocity of one long run of the corpus (SoftDECA 3.4)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...lhm.base.errors import InputError, SoftdecaError
from ...lhm.base.files.npz import read_arrays
from ...lhm.base.files.pack import load_packed, save_packed
from ...lhm.base.mesh import Floats
from ...lhm.base.progress import OnProgress, silent
from ...lhm.expressions import Take, conversation, rotations
from ...lhm.head.head import LayeredHead
from ...reference import Sequence
from ...reference.face.dynamics import extrapolate_turns
from ...reference.face.face import Face
from ...reference.face.sequence import Velocities, is_plausible
from .face import People
from .plan import LENGTH, RATE, VELOCITIES, CorpusPlan
from .shard import ACCEPTED
from .simulator import Answer, describe_answer, reject_moved

RUN = "velocities.npz"
RUN_TOLERANCE = 5e-4
"""Tolerance of the run, whose velocities only start sequences."""


@dataclass(frozen=True, eq=False)
class SequenceAnswer:
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
    def failed(cls, status: str, take: Take, first: int, n: int) -> SequenceAnswer:
        """Make the row of a sequence that failed."""
        none = np.zeros(LENGTH)
        motion = np.zeros((LENGTH, n, 3), dtype=np.float16)
        weights, turned = _driven(take, first)
        return cls(weights, turned, np.zeros((2, n, 3)), motion, status, none, none, none, none, none)


def simulate_sequence(
    plan: CorpusPlan, face: Face, take: Take, first: int, velocities: Velocities, rng: np.random.Generator
) -> SequenceAnswer:
    """Simulate the frames from `first` on, begun with a random one of the velocities; a failure is a status."""
    n = len(face.skin.vertices)
    weights, turned = _driven(take, first)
    try:
        velocity = _velocity(face.head, velocities, rng)
        running = Sequence(face, time_step=1.0 / RATE, dynamic=True, tolerance=plan.tolerance)
        expressions = [face.blend(w) for w in weights]
        begun = running.begin(expressions[0], velocity=velocity, base=extrapolate_turns(turned))
        at_rest = face.skin_after(weights[0], begun.positions) - expressions[0]
        frames = zip(weights, expressions, turned, strict=True)
        answers = [
            describe_answer(plan, face, w, running.frame(expression, base=base)) for w, expression, base in frames
        ]
    except SoftdecaError as error:
        return SequenceAnswer.failed(f"sequence: {error}", take, first, n)
    before = np.stack([at_rest, at_rest - velocity / RATE])
    return SequenceAnswer(
        weights=weights,
        rotations=turned,
        before=before,
        corrected=np.stack([answer.corrected for answer in answers]),
        status=reject_moved(before) or _status(answers),
        iterations=np.array([answer.iterations for answer in answers]),
        residual=np.array([answer.residual for answer in answers]),
        smallest_volume_ratio=np.array([answer.smallest_volume_ratio for answer in answers]),
        inverted=np.array([answer.inverted for answer in answers]),
        crossings=np.array([answer.crossings for answer in answers]),
    )


def _velocity(head: LayeredHead, velocities: Velocities, rng: np.random.Generator) -> Floats:
    """Draw a plausible velocity [mm/s], shape (n, 3); zero where a hundred are not."""
    for _ in range(100):
        velocity = velocities.on(head, int(rng.integers(len(velocities))))
        if is_plausible(velocity, 1.0 / RATE):
            return velocity
    return np.zeros(head.skin.vertices.shape)


def _driven(take: Take, first: int) -> tuple[Floats, Floats]:
    """Return weights and head rotations of a sequence's frames."""
    part = take.part(slice(first, first + LENGTH))
    turned = np.tile(np.eye(3), (LENGTH, 1, 1)) if part.head is None else rotations(part.head)
    return part.weights.astype(np.float32), turned


def _status(answers: list[Answer]) -> str:
    bad = [(k, answer.status) for k, answer in enumerate(answers) if answer.status != ACCEPTED]
    return f"frame {bad[0][0]}: {bad[0][1]}" if bad else ACCEPTED


def load_velocities(folder: Path, plan: CorpusPlan, people: People, *, on_progress: OnProgress = silent) -> Velocities:
    """Read, or run, `plan.run` frames of made-up conversation on the plan's first person, default p.

    Kept in the corpus' folder; made anew where the file is missing or damaged.
    """
    path, form = folder / RUN, _form(plan, people.name)
    try:
        kept = load_packed(
            path, form, Velocities, what="the velocities of a corpus", else_do="they are made anew"
        ).local
    except InputError:
        kept = _run(plan, people, on_progress).local.astype(np.float16)
        save_packed(path, form, Velocities(kept))
    return Velocities(kept.astype(np.float32))


def check_velocities(folder: Path, plan: CorpusPlan, people: str, else_do: str) -> None:
    """Raise InputError for velocities of another plan, or of other people."""
    try:
        form = str(read_arrays(folder / RUN, "format")["format"])
    except InputError:
        return
    if form != _form(plan, people):
        raise InputError(f"{folder / RUN}: of another corpus; {else_do}")


def _form(plan: CorpusPlan, people: str) -> str:
    return f"softdeca velocities 1 of {plan.digest}-{people}"


def _run(plan: CorpusPlan, people: People, on_progress: OnProgress) -> Velocities:
    person = people.person(plan.rng(VELOCITIES))
    weights = conversation(plan.rng(VELOCITIES, 1), plan.run, rate=RATE)
    face = Face(people.head(person), person.shapes, choices={"cells": plan.cells})
    running = Sequence(face, time_step=1.0 / RATE, dynamic=True, tolerance=RUN_TOLERANCE)

    def expressions():
        begin = time.monotonic()
        for number, w in enumerate(weights):
            yield face.blend(w)
            minutes = (time.monotonic() - begin) / (number + 1) * (plan.run - number - 1) / 60.0
            on_progress(
                f"velocities: a long run for all sequences, frame {number + 1} of {plan.run}, {minutes:.0f} min left",
                (number + 1) / plan.run,
            )

    return Velocities.from_sequence(running, expressions())
