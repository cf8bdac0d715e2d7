"""One person of a corpus: the head, and under each parameter set the settled face, its responses, and its frames.

Each frame starts from the settled neutral face, led on by its responses: it depends on plan and person only, and any
one can be had again alone.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...lhm.base.errors import SoftdecaError
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.head import LayeredHead
from ...reference.face.velocities import Velocities
from .group import Answer, Group, settled_neutral
from .mixture import ParameterSet
from .person import People, Person
from .plan import IDENTITY, LENGTH, VELOCITIES, CorpusPlan, Static
from .references import FEM_LAWS, Reference, references
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

GENERATOR = 8
"""Of what is simulated from a plan; raised when answers change, so that shards of two are not mixed."""


@dataclass(eq=False)
class _Made:
    """One group's row of the plan, and what is simulated under it.

    failure: why there is no settled face, else empty; then answers are those of all frames all the same.
    """

    number: int
    parameters: ParameterSet
    failure: str = ""
    settled: np.ndarray | None = None
    frames: list[tuple[Static, Floats32]] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)
    sequences: list[tuple[str, int, Rolled]] = field(default_factory=list)
    responses: list[tuple[bool, Floats, Floats]] = field(default_factory=list)
    parameter_responses: dict[str, Floats] = field(default_factory=dict)
    references: list[tuple[int, list[Reference]]] = field(default_factory=list)


def simulate_person(plan: CorpusPlan, people: People, identity: int, velocities: Velocities | None = None) -> Shard:
    """All that the plan asks of one person; what fails becomes a status with its reason.

    Sequences begin with one of the velocities, which a plan with sequences needs.
    """
    clock = _Clock()
    with clock("shapes"):
        person = people.person(plan.rng(IDENTITY, identity))
    with clock("fit"):
        head, failure = _head(people, person)
    made = [_Made(number, plan.parameter_set(number), failure) for number in plan.parameter_numbers(identity)]
    turns = _turns(plan, identity, made)
    for k, one in enumerate(made):
        # Under no name here, so that a group's factors, a quarter of a gigabyte, are forgotten before the next.
        _simulate(
            plan, person, identity, k, None if head is None else _group(plan, people, person, head, k, one, clock),
            one, velocities, turns[k], clock,
        )  # fmt: skip
    return Shard(
        persons=_persons(person),
        groups=_groups(person, made),
        statics=_statics(person, made),
        sequences=_sequences(person, made),
        responses=_responses(person, made),
        parameter_responses=_parameter_responses(person, made),
        references=_references(plan, person, made),
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


def _group(plan, people, person, head, k: int, one: _Made, clock) -> Group | None:
    try:
        with clock("settling"):
            if plan.settles_only(k, one.number):
                one.settled = settled_neutral(people, head, one.parameters).displacement
                return None
            return Group.of(plan, people, person, head, one.number)
    except SoftdecaError as error:
        one.failure = f"settling: {error}"
        return None


def _simulate(
    plan: CorpusPlan,
    person: Person,
    identity: int,
    k: int,
    group: Group | None,
    one: _Made,
    velocities: Velocities | None,
    references_wanted: int,
    clock: _Clock,
):
    """Fill in what the plan asks of a person's k-th group."""
    one.frames = [(static, plan.weights(static)) for static in plan.statics(identity, k)]
    with clock("statics"):
        for _, weights in one.frames:
            one.answers.append(Answer.failed(one.failure, person.skin) if group is None else group.static(weights))
    if k < plan.sequences:
        with clock("sequences"):
            one.sequences.append(_sequence(plan, person, identity, k, group, one, velocities))
    if group is None:
        return
    one.settled = group.settled
    with clock("derivatives"):
        if group.wanted[0]:
            one.responses.append((group.exact, group.offset, group.responses))
        if group.wanted[1]:
            one.parameter_responses = group.parameter_responses
    with clock("references"):
        accepted = [row for row, answer in enumerate(one.answers) if answer.status == ACCEPTED]
        for row in accepted[:references_wanted]:
            expressed = one.frames[row][1].astype(np.float64)
            one.references.append((row, references(group, expressed, one.answers[row])))


def _sequence(plan, person, identity, k, group, one: _Made, velocities) -> tuple[str, int, Rolled]:
    name, first = plan.sequence(identity, k)
    take = plan.take(name)
    if group is None:
        return name, first, Rolled.failed(one.failure, take, first, len(person.skin.vertices))
    return name, first, rolled(plan, group, take, first, velocities, plan.rng(VELOCITIES, 2, identity, k))


def _turns(plan: CorpusPlan, identity: int, made: list[_Made]) -> list[int]:
    """How many frames of each group FEniCSx solves, too: of people in test, in turns of groups that have both laws."""
    wanted = plan.references if plan.split(identity) == "test" else 0
    plain = [g for g, one in enumerate(made) if one.parameters.uniform and "strain_limit" not in one.parameters.names]
    order = [g for _ in range(plan.frames) for g in (plain or range(len(made)))]
    return [order[:wanted].count(g) for g in range(len(made))]


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
        settled=np.stack([none if one.settled is None else one.settled for one in made]).astype(np.float16),
        status=texts(one.failure or ACCEPTED for one in made),
    )


def _statics(person: Person, made: list[_Made]) -> Statics:
    frames = [(g, static, weights) for g, one in enumerate(made) for static, weights in one.frames]
    return Statics(
        group=np.array([g for g, _, _ in frames], dtype=np.int64),
        recording=texts(static.recording for _, static, _ in frames),
        frame=np.array([static.frame for _, static, _ in frames], dtype=np.int64),
        weights=np.array([weights for _, _, weights in frames], dtype=np.float32).reshape(-1, 52),
        **_stacked([answer for one in made for answer in one.answers], person),
    )


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


def _sequences(person: Person, made: list[_Made]) -> Sequences:
    n = len(person.skin.vertices)
    found = [(g, *sequence) for g, one in enumerate(made) for sequence in one.sequences]
    rolls = [roll for _, _, _, roll in found]

    def stacked(name: str, dtype, *shape: int) -> np.ndarray:
        return np.array([getattr(roll, name) for roll in rolls], dtype=dtype).reshape(-1, *shape)

    return Sequences(
        group=np.array([g for g, _, _, _ in found], dtype=np.int64),
        recording=texts(name for _, name, _, _ in found),
        frame=np.array([first for _, _, first, _ in found], dtype=np.int64),
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


def _responses(person: Person, made: list[_Made]) -> Responses:
    n = len(person.skin.vertices)
    found = [(g, *responses) for g, one in enumerate(made) for responses in one.responses]
    return Responses(
        group=np.array([g for g, _, _, _ in found], dtype=np.int64),
        exact=np.array([exact for _, exact, _, _ in found], dtype=bool),
        offset=np.array([offset for _, _, offset, _ in found], dtype=np.float16).reshape(-1, n, 3),
        expressions=np.array([changes for _, _, _, changes in found], dtype=np.float16).reshape(-1, 52, n, 3),
    )


def _parameter_responses(person: Person, made: list[_Made]) -> ParameterResponses:
    n = len(person.skin.vertices)
    found = [(g, name, change) for g, one in enumerate(made) for name, change in one.parameter_responses.items()]
    return ParameterResponses(
        group=np.array([g for g, _, _ in found], dtype=np.int64),
        name=texts(name for _, name, _ in found),
        change=np.array([change for _, _, change in found], dtype=np.float16).reshape(-1, n, 3),
    )


def _references(plan: CorpusPlan, person: Person, made: list[_Made]) -> References:
    n = len(person.skin.vertices)
    found = [
        (g * plan.frames + row, law, answer)
        for g, one in enumerate(made)
        for row, answers in one.references
        for law, answer in zip(FEM_LAWS, answers, strict=True)
    ]
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
