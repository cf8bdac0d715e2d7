"""Sixteen consecutive frames with inertia (SoftDECA 3.4), from a random velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import SoftdecaError
from ...lhm.base.mesh import Floats
from ...lhm.expressions import Take, rotations
from ...lhm.head import LayeredHead
from ...reference import Sequence
from ...reference.face.base import turns_before
from ...reference.face.velocities import Velocities, plausible
from .group import Answer, Group
from .plan import LENGTH, RATE, CorpusPlan
from .shard import ACCEPTED


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
    plan: CorpusPlan, group: Group, take: Take, first: int, velocities: Velocities, rng: np.random.Generator
) -> Rolled:
    """Simulate the frames from `first` on, begun with a random one of the velocities; a failure is a status."""
    n = len(group.person.skin.vertices)
    weights, turned = _driven(take, first)
    try:
        velocity = _velocity(group.head, velocities, rng)
        running = Sequence.of(group.neutral, time_step=1.0 / RATE, dynamic=True, tolerance=plan.tolerance)
        expressions = [group.expression(w) for w in weights]
        begun = running.begin(expressions[0], velocity=velocity, base=turns_before(turned))
        at_rest = group.corrected(weights[0], begun.positions)
        frames = zip(weights, expressions, turned, strict=True)
        answers = [group.answer(w, running.frame(expression, base=base)) for w, expression, base in frames]
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
        if plausible(velocity, 1.0 / RATE):
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
