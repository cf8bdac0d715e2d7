"""One person of a corpus: the head, and under each parameter set the settled face, its responses, and its frames.

Each frame starts from the settled neutral face, led on by its responses: it depends on plan and person only, and any
one can be had again alone.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...lhm.base.errors import SoftdecaError
from ...lhm.head.head import LayeredHead
from ...reference.face.face import Face
from ...reference.face.sequence import Velocities
from .face import People, Person
from .mixture import ParameterSet
from .plan import IDENTITY, VELOCITIES, CorpusPlan
from .references import references
from .sequences import SequenceAnswer, simulate_sequence
from .shard import ACCEPTED, FARTHEST, TABLES, Shard, stack_rows
from .simulator import (
    Answer,
    make_face,
    prepare_face,
    reject_moved,
    simulate_static,
)

GENERATOR = 11
"""Version of the simulation of a plan, raised when answers change: shards of two versions are not mixed."""


def simulate_person(plan: CorpusPlan, people: People, identity: int, velocities: Velocities | None = None) -> Shard:
    """Simulate all that the plan asks of one person; a failure becomes a status with its reason.

    Sequences begin with one of the velocities, which a plan with sequences needs.
    """
    making = _PersonRows(plan, people, identity, velocities)
    sets = [plan.parameter_set(number) for number in plan.parameter_numbers(identity)]
    for group, (parameters, count) in enumerate(zip(sets, _references_of(plan, identity, sets), strict=True)):
        making.add_group(group, parameters, count)
    n = len(making.person.skin.vertices)
    tables = {table: stack_rows(kind, making.rows[table], n) for table, kind in TABLES.items()}
    return Shard(**tables, seconds=making.seconds)


class _PersonRows:
    """The rows of a person's tables as they are simulated, and processor seconds by phase."""

    def __init__(self, plan: CorpusPlan, people: People, identity: int, velocities: Velocities | None):
        self.plan, self.people, self.identity, self._velocities = plan, people, identity, velocities
        self.seconds: dict[str, float] = {}
        self.rows: dict[str, list[dict[str, Any]]] = {table: [] for table in TABLES}
        with self._time_phase("shapes"):
            self.person: Person = people.person(plan.rng(IDENTITY, identity))
        with self._time_phase("fit"):
            self._head: LayeredHead | None = None
            self._no_head = ACCEPTED
            try:
                self._head = people.head(self.person)
            except SoftdecaError as error:
                self._no_head = f"head: {error}"
        person = self.person
        self.rows["persons"].append({"code": person.code, "skin": person.skin.vertices, "shapes": person.shapes})

    def add_group(self, group: int, parameters: ParameterSet, references_wanted: int) -> None:
        """Simulate all of one parameter set."""
        plan, number = self.plan, self.plan.parameter_numbers(self.identity)[group]
        # A function of its own, so that a face's factors, a quarter of a gigabyte, are forgotten before the next.
        status, settled, face = self._settle(parameters)
        self.rows["groups"].append(
            {
                "number": number,
                "kind": parameters.kind,
                "varied": parameters.varied,
                "coefficients": parameters.coefficients,
                "settled": settled,
                "carried": np.zeros_like(settled) if face is None else face.carried,
                "status": status,
            }
        )
        answers = self._add_statics(group, face, status)
        if group < plan.sequences:
            with self._time_phase("sequences"):
                self._add_sequence(group, face, status)
        if face is not None:
            with self._time_phase("derivatives"):
                if plan.has_responses(number):
                    self._add_responses(group, face)
            with self._time_phase("references"):
                self._add_references(group, face, answers, references_wanted)

    def _settle(self, parameters: ParameterSet) -> tuple[str, np.ndarray, Face | None]:
        """Return the group's status, how far the skin moves [mm], (n, 3), and the face where the plan asks for more."""
        still = np.zeros_like(self.person.skin.vertices)
        if self._head is None:
            return self._no_head, still, None
        try:
            with self._time_phase("settling"):
                choices: Any = {"contact": self.plan.contact, "cells": self.plan.cells}
                face = make_face(self.people, self.person, self._head, parameters, **choices)
                prepare_face(face)
        except SoftdecaError as error:
            return f"settling: {error}", still, None
        return ACCEPTED, face.settled().displacement, face

    def _add_statics(self, group: int, face: Face | None, status: str) -> list[Answer]:
        answers = []
        with self._time_phase("statics"):
            for static in self.plan.statics(self.identity, group):
                weights = self.plan.weights(static)
                failed = Answer.failed(status, self.person.skin)
                answer = failed if face is None else simulate_static(self.plan, face, weights)
                answers.append(answer)
                named = {"group": group, "recording": static.recording, "frame": static.frame, "weights": weights}
                self.rows["statics"].append(named | vars(answer))
        return answers

    def _add_sequence(self, group: int, face: Face | None, status: str) -> None:
        plan, velocities = self.plan, self._velocities
        name, first = plan.sequence(self.identity, group)
        take = plan.take(name)
        if face is None:
            sequence = SequenceAnswer.failed(status, take, first, len(self.person.skin.vertices))
        else:
            assert velocities is not None
            rng = plan.rng(VELOCITIES, 2, self.identity, group)
            sequence = simulate_sequence(plan, face, take, first, velocities, rng)
        self.rows["sequences"].append({"group": group, "recording": name, "frame": first} | vars(sequence))

    def _add_responses(self, group: int, face: Face) -> None:
        if not (reject_moved(face.offset) or reject_moved(face.responses, FARTHEST)):
            exact = face.derivatives.is_exact
            self.rows["responses"].append(
                {"group": group, "exact": exact, "offset": face.offset, "expressions": face.responses}
            )

    def _add_references(self, group: int, face: Face, answers: list[Answer], count: int) -> None:
        first, statics = group * self.plan.frames, self.rows["statics"]
        chosen = [row for row, answer in enumerate(answers) if answer.status == ACCEPTED][:count]
        frames = [(statics[first + row]["weights"].astype(np.float64), answers[row]) for row in chosen]
        for row, by_law in zip(chosen, references(self.plan, face, frames), strict=True):
            for law, reference in by_law.items():
                self.rows["references"].append({"static": first + row, "law": law} | vars(reference))

    @contextmanager
    def _time_phase(self, phase: str) -> Iterator[None]:
        begin = time.process_time()
        yield
        self.seconds[phase] = self.seconds.get(phase, 0.0) + time.process_time() - begin


def _references_of(plan: CorpusPlan, identity: int, sets: list[ParameterSet]) -> list[int]:
    """Count the frames of each group that FEniCSx solves, too: of people in test, in turns of groups with both laws."""
    wanted = plan.references if plan.split(identity) == "test" else 0
    plain = [g for g, drawn in enumerate(sets) if drawn.uniform and "strain_limit" not in drawn.names]
    order = [g for _ in range(plan.frames) for g in (plain or range(len(sets)))]
    return [order[:wanted].count(g) for g in range(len(sets))]
