"""One person of a corpus: the head, and under each parameter set the settled face, its responses, and its frames.

Each frame starts from the settled neutral face, led on by its responses: it depends on plan and person only, and any
one can be had again alone.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...lhm.errors import SoftdecaError
from ...lhm.head import LayeredHead
from ...reference.velocities import Velocities
from .group import Answer, Group
from .mixture import ParameterSet
from .person import People, Person
from .plan import IDENTITY, LENGTH, VELOCITIES, CorpusPlan
from .references import FEM_LAWS, references
from .sequences import Rolled, rolled
from .shard import (
    ACCEPTED,
    Groups,
    ParameterResponses,
    Persons,
    References,
    Responses,
    Sequences,
    Shard,
    Statics,
    texts,
)

GENERATOR = 2
"""Of what is simulated from a plan; raised when answers change, so that shards of two are not mixed."""


@dataclass(frozen=True, eq=False)
class _Made:
    """One group's row of the plan, and what was simulated of it, None where the head or the settling failed."""

    number: int
    parameters: ParameterSet
    group: Group | None
    status: str


def simulate_person(plan: CorpusPlan, people: People, identity: int, velocities: Velocities | None = None) -> Shard:
    """All that the plan asks of one person; what fails becomes a status with its reason.

    Sequences begin with one of the velocities, which a plan with sequences needs.
    """
    clock = _Clock()
    with clock("shapes"):
        person = people.person(plan.rng(IDENTITY, identity))
    with clock("fit"):
        head, failure = _head(people, person)
    made = [_made(plan, people, person, head, failure, number, clock) for number in plan.parameter_numbers(identity)]
    statics, answers = _statics(plan, person, identity, made, clock)
    with clock("derivatives"):
        responses, parameter_responses = _responses(person, made), _parameter_responses(person, made)
    return Shard(
        persons=_persons(person),
        groups=_groups(person, made),
        statics=statics,
        sequences=_sequences(plan, person, identity, made, velocities, clock),
        responses=responses,
        parameter_responses=parameter_responses,
        references=_references(plan, person, identity, made, answers, clock),
        seconds=clock.seconds,
    )


def simulate_static(plan: CorpusPlan, people: People, identity: int, index: int) -> Answer:
    """One static frame alone, by its row in the person's shard; bit for bit what the shard has.

    Raises what the head's fit and the simulation raise.
    """
    person = people.person(plan.rng(IDENTITY, identity))
    number = plan.parameter_numbers(identity)[index // plan.frames]
    group = Group.of(plan, people, person, people.head(person), number)
    return group.static(plan.weights(plan.static(identity, index)))


def _head(people: People, person: Person) -> tuple[LayeredHead | None, str]:
    try:
        return people.head(person), ACCEPTED
    except SoftdecaError as error:
        return None, f"head: {error}"


def _made(plan, people, person, head, failure, number, clock) -> _Made:
    parameters = plan.parameter_set(number)
    if head is None:
        return _Made(number, parameters, None, failure)
    try:
        with clock("settling"):
            group = Group.of(plan, people, person, head, number)
        return _Made(number, parameters, group, ACCEPTED)
    except SoftdecaError as error:
        return _Made(number, parameters, None, f"settling: {error}")


def _persons(person: Person) -> Persons:
    n = len(person.skin.vertices)
    shapes = person.shapes[None] if person.personal else np.empty((0, 52, n, 3))
    return Persons(person.code[None], person.skin.vertices[None].astype(np.float32), shapes.astype(np.float16))


def _groups(person: Person, made: list[_Made]) -> Groups:
    none = np.zeros_like(person.skin.vertices)
    return Groups(
        number=np.array([one.number for one in made]),
        kind=texts(one.parameters.kind for one in made),
        varied=np.stack([one.parameters.varied for one in made]),
        coefficients=np.stack([one.parameters.coefficients for one in made]),
        settled=np.stack([none if one.group is None else one.group.settled for one in made]).astype(np.float16),
        status=texts(one.status for one in made),
    )


def _statics(plan: CorpusPlan, person: Person, identity: int, made: list[_Made], clock) -> tuple[Statics, list[Answer]]:
    asked = [(g, plan.static(identity, g * plan.frames + k)) for g in range(len(made)) for k in range(plan.frames)]
    weights = np.array([plan.weights(static) for _, static in asked]).reshape(-1, 52).astype(np.float32)
    answers = []
    with clock("statics"):
        for (g, _), w in zip(asked, weights, strict=True):
            group = made[g].group
            answers.append(Answer.failed(made[g].status, person.skin) if group is None else group.static(w))
    found = _stacked(answers, person)
    return Statics(
        group=np.array([g for g, _ in asked], dtype=np.int64),
        recording=texts(static.recording for _, static in asked),
        frame=np.array([static.frame for _, static in asked], dtype=np.int64),
        weights=weights,
        **found,
    ), answers


def _stacked(answers: list[Answer], person: Person) -> dict[str, Any]:
    """The answers' fields as arrays, one row each."""
    corrected = np.array([one.corrected for one in answers], dtype=np.float16)
    return {
        "corrected": corrected.reshape(-1, *person.skin.vertices.shape),
        "moved": np.array([one.moved for one in answers], dtype=np.float32).reshape(-1, 2),
        "status": texts(one.status for one in answers),
        "iterations": np.array([one.iterations for one in answers], dtype=np.int64),
        "residual": np.array([one.residual for one in answers], dtype=np.float32),
        "smallest_volume_ratio": np.array([one.smallest_volume_ratio for one in answers], dtype=np.float32),
        "inverted": np.array([one.inverted for one in answers], dtype=np.int64),
        "crossings": np.array([one.crossings for one in answers], dtype=np.int64),
    }


def _sequences(plan: CorpusPlan, person: Person, identity: int, made, velocities, clock) -> Sequences:
    n = len(person.skin.vertices)
    found: list[tuple[str, int, Rolled]] = []
    with clock("sequences"):
        for k in range(plan.sequences):
            name, first = plan.sequence(identity, k)
            take = plan.take(name)
            group = made[k].group
            if group is None:
                found.append((name, first, Rolled.failed(made[k].status, take, first, n)))
            else:
                rng = plan.rng(VELOCITIES, 2, identity, k)
                found.append((name, first, rolled(plan, group, take, first, velocities, rng)))
    rolls = [roll for _, _, roll in found]

    def stacked(name: str, dtype, *shape: int) -> np.ndarray:
        return np.array([getattr(roll, name) for roll in rolls], dtype=dtype).reshape(-1, *shape)

    return Sequences(
        group=np.arange(len(found)),
        recording=texts(name for name, _, _ in found),
        frame=np.array([first for _, first, _ in found], dtype=np.int64),
        weights=stacked("weights", np.float32, LENGTH, 52),
        rotations=stacked("rotations", np.float32, LENGTH, 3, 3),
        before=stacked("before", np.float16, 2, n, 3),
        corrected=stacked("corrected", np.float16, LENGTH, n, 3),
        status=texts(roll.status for roll in rolls),
        iterations=stacked("iterations", np.int64, LENGTH),
        residual=stacked("residual", np.float32, LENGTH),
        smallest_volume_ratio=stacked("smallest_volume_ratio", np.float32, LENGTH),
        inverted=stacked("inverted", np.int64, LENGTH),
        crossings=stacked("crossings", np.int64, LENGTH),
    )


def _wanted(made: list[_Made], kind: int) -> list[tuple[int, Group]]:
    """The groups with derivatives by expressions (kind 0) or by parameters (kind 1)."""
    return [(g, one.group) for g, one in enumerate(made) if one.group is not None and one.group.wanted[kind]]


def _responses(person: Person, made: list[_Made]) -> Responses:
    n, wanted = len(person.skin.vertices), _wanted(made, 0)
    return Responses(
        group=np.array([g for g, _ in wanted], dtype=np.int64),
        exact=np.array([group.exact for _, group in wanted], dtype=bool),
        offset=np.array([group.offset for _, group in wanted], dtype=np.float16).reshape(-1, n, 3),
        expressions=np.array([group.responses for _, group in wanted], dtype=np.float16).reshape(-1, 52, n, 3),
    )


def _parameter_responses(person: Person, made: list[_Made]) -> ParameterResponses:
    n = len(person.skin.vertices)
    found = [(g, name, change) for g, group in _wanted(made, 1) for name, change in group.parameter_responses.items()]
    return ParameterResponses(
        group=np.array([g for g, _, _ in found], dtype=np.int64),
        name=texts(name for _, name, _ in found),
        change=np.array([change for _, _, change in found], dtype=np.float16).reshape(-1, n, 3),
    )


def _references(plan: CorpusPlan, person, identity: int, made, answers: list[Answer], clock) -> References:
    """FEniCSx on the first accepted frames of a person in test, in turns of the groups that have both laws, if any."""
    n, found = len(person.skin.vertices), []
    wanted = plan.references if plan.split(identity) == "test" else 0
    plain = [g for g, one in enumerate(made) if one.parameters.uniform and "strain_limit" not in one.parameters.names]
    order = [g * plan.frames + k for k in range(plan.frames) for g in (plain or range(len(made)))]
    with clock("references"):
        for row in [row for row in order if answers[row].status == ACCEPTED][:wanted]:
            group = made[row // plan.frames].group
            weights = plan.weights(plan.static(identity, row)).astype(np.float32).astype(np.float64)
            answered = references(group, weights, answers[row])
            found += [(row, law, one) for law, one in zip(FEM_LAWS, answered, strict=True)]
    return References(
        static=np.array([row for row, _, _ in found], dtype=np.int64),
        law=texts(law for _, law, _ in found),
        corrected=np.array([one.corrected for _, _, one in found], dtype=np.float16).reshape(-1, n, 3),
        status=texts(one.status for _, _, one in found),
        iterations=np.array([one.iterations for _, _, one in found], dtype=np.int64),
    )


class _Clock:
    """Processor seconds by phase."""

    def __init__(self):
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, phase: str) -> Iterator[None]:
        begin = time.process_time()
        yield
        self.seconds[phase] = self.seconds.get(phase, 0.0) + time.process_time() - begin
