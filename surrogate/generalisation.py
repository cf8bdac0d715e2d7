"""Generalisation by people, parameters and recordings apart: faces under every combination of known and unseen.

A corpus' test shares none of the three with training, so that its errors do not tell which of them is hard. Here those
of a pair, somebody whom the network knows and somebody of test, each take the other's parameter set too, and all four
faces make frames of recordings of training and of test: eight combinations, which differ in one thing at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from ..lhm.base.errors import InputError, SoftdecaError
from ..lhm.base.files.npz import read_arrays, write_arrays
from ..lhm.base.files.resumable import begin_work, lock_folder
from ..lhm.base.progress import OnProgress, silent
from .corpus.face import Derivatives, Face, Frames
from .corpus.folder import simulated_of
from .corpus.people import People, Person
from .corpus.plan import IDENTITY, SPLITS, CorpusPlan, Split
from .corpus.shard import ACCEPTED
from .corpus.simulator import FaceSimulator
from .evaluate import ALL, Score, evaluate
from .heads import BindCosts, Heads
from .methods import Method
from .networks.weights import Weights
from .schedule import Schedule, results_of

COMBINATIONS: tuple[tuple[Split, Split, Split], ...] = tuple(product(SPLITS, SPLITS, SPLITS))
"""From which split people, parameters and recordings are."""
ALIKE = 0.05
"""By how much the mean code of a plan's people may be off the one that weights were trained on, over its spread."""


def kind_of(combination: Sequence[Split]) -> str:
    """What of a combination is unseen, as scores call it."""
    aspects = zip(("people", "parameters", "recordings"), combination, strict=True)
    return f"unseen: {', '.join(name for name, split in aspects if split == 'test') or 'nothing'}"


KINDS = tuple(map(kind_of, COMBINATIONS))


@dataclass(frozen=True)
class Pair:
    """Somebody known and somebody of test by their numbers, and each one's parameter set."""

    number: int
    people: Mapping[Split, int]
    parameters: Mapping[Split, int]
    group: int


def pairs(plan: CorpusPlan, weights: Weights, count: int) -> list[Pair]:
    """The first `count` pairs; the k-th takes the (k mod groups)-th parameter set of both.

    InputError where training or test has fewer people.
    """
    held = set(weights.note.held)
    known = [k for k in range(weights.note.people + len(held)) if k not in held]
    most = min(len(known), plan.tested)
    if not 1 <= count <= most:
        raise InputError(f"generalisation: expected 1 to {most} pairs of people, got {count}")
    made = []
    for number in range(count):
        people: dict[Split, int] = {"train": known[number], "test": plan.trained + number}
        group = number % plan.groups
        sets: dict[Split, int] = {split: plan.parameter_numbers(one)[group] for split, one in people.items()}
        made.append(Pair(number, people, sets, group))
    return made


def check_learned(plan: CorpusPlan, people: People, weights: Weights) -> None:
    """Raise InputError for weights that have not learned from the plan's first people, as their mean code tells."""
    first = weights.note.people + len(weights.note.held)
    if first <= plan.trained:
        codes = np.stack([people.person(plan.rng(IDENTITY, k)).code for k in range(first)])
        if codes.shape[1:] == weights.code_mean.shape:
            off = np.abs(codes.mean(axis=0) - weights.code_mean) / weights.code_scale
            if off.max() <= ALIKE:
                return
    raise InputError("generalisation: the weights did not learn from this corpus' people, so which are known is unsaid")


def evaluate_generalisation(
    methods: Sequence[Method],
    weights: Weights,
    plan: CorpusPlan,
    people: People,
    folder: Path,
    *,
    count: int,
    on: Schedule,
    costs: BindCosts | None = None,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Scores by kind (KINDS) of methods, which are fitted, on `count` pairs of people; a minute of a core each.

    What is simulated is kept in the folder, where it goes on if it was stopped. Raises InputError where the weights did
    not learn from the plan's people, for more pairs than there are, and for a folder of something else; SoftdecaError
    where no frame of some combination is accepted.
    """
    check_learned(plan, people, weights)
    wanted = pairs(plan, weights, count)
    work = _Work(folder, plan, people)
    with lock_folder(folder, "generalisation"):
        begin_work(folder / "generalisation.json", "generalisation", simulated_of(plan, people))
        pending = [pair for pair in wanted if not work.is_whole(pair)]
        for done, _ in enumerate(results_of(work, pending, on=on, name="generalisation")):
            on_progress("generalisation: pairs of people simulated", (done + 1) / len(pending))
    scores: list[Score] = []
    heads = Heads(people)
    for combination, kind in zip(COMBINATIONS, KINDS, strict=True):
        found = evaluate(methods, _Combination.of(work, wanted, combination), heads, costs=costs)
        scores += [replace(score, kind=kind) for score in found if score.kind == ALL]
        on_progress(f"generalisation, {kind}", len(scores) / len(methods) / len(COMBINATIONS))
    return scores


@dataclass(frozen=True, eq=False)
class _Work:
    """Simulates a pair's four faces, with frames of recordings of both splits, into a file."""

    folder: Path
    plan: CorpusPlan
    people: People

    def path(self, pair: Pair) -> Path:
        return self.folder / f"pair-{pair.number:03d}.npz"

    def is_whole(self, pair: Pair) -> bool:
        try:
            read_arrays(self.path(pair))
        except InputError:
            return False
        return True

    def __call__(self, pair: Pair) -> None:
        arrays: dict[str, np.ndarray] = {}
        for whose, by in product(SPLITS, SPLITS):
            made = self._face(pair, whose, by)
            arrays |= {f"{whose}/{by}/{name}": values for name, values in made.items()}
        write_arrays(self.path(pair), arrays)

    def _face(self, pair: Pair, whose: Split, by: Split) -> dict[str, np.ndarray]:
        """Nothing where the face has no head, or does not come to rest."""
        plan, number = self.plan, pair.parameters[by]
        person = self.person(pair, whose)
        try:
            face = FaceSimulator.of(plan, self.people, person, self.people.head(person), plan.parameter_set(number))
        except SoftdecaError:
            return {}
        known = face.derivatives
        derived = {"settled": face.neutral.displacement, "offset": known.offset, "responses": known.responses}
        found: dict[str, np.ndarray] = {name: values.astype(np.float16) for name, values in derived.items()}
        for split in SPLITS:
            rows = [plan.weights(static) for static in plan.statics(pair.people[split], pair.group)]
            answers = [face.static(weights) for weights in rows]
            accepted = [k for k, answer in enumerate(answers) if answer.status == ACCEPTED]
            found[f"{split}/weights"] = np.array([rows[k] for k in accepted], dtype=np.float32).reshape(-1, 52)
            corrected = [answers[k].corrected for k in accepted]
            found[f"{split}/corrected"] = np.array(corrected, dtype=np.float16).reshape(-1, *person.skin.vertices.shape)
        return found

    def read(self, pair: Pair, combination: tuple[Split, Split, Split]) -> tuple[Face, Frames] | None:
        """A face of a pair with its frames; None where there is none."""
        whose, by, of = combination
        arrays = read_arrays(self.path(pair))
        if f"{whose}/{by}/offset" not in arrays:
            return None
        names = ("settled", "offset", "responses", f"{of}/weights", f"{of}/corrected")
        settled, offset, responses, weights, corrected = (arrays[f"{whose}/{by}/{name}"] for name in names)
        person, drawn = self.person(pair, whose), self.plan.parameter_set(pair.parameters[by])
        face = Face(pair.people[whose], person, drawn, settled, Derivatives(offset, responses))
        return face, Frames(weights, corrected)

    def person(self, pair: Pair, whose: Split) -> Person:
        return self.people.person(self.plan.rng(IDENTITY, pair.people[whose]))


@dataclass(frozen=True, eq=False)
class _Combination:
    """The faces of one combination that there are, with their frames, as `evaluate` asks for them."""

    made: Sequence[tuple[Face, Frames]]

    @classmethod
    def of(cls, work: _Work, wanted: Sequence[Pair], combination: tuple[Split, Split, Split]) -> _Combination:
        """Read them; SoftdecaError where they have no frame."""
        made = [one for pair in wanted if (one := work.read(pair, combination)) is not None]
        if not any(len(frames.weights) for _, frames in made):
            raise SoftdecaError(f"generalisation: of {kind_of(combination)} no frame was accepted")
        return cls(made)

    def __len__(self) -> int:
        return len(self.made)

    def face(self, index: int) -> Face:
        """One of them."""
        return self.made[index][0]

    def frames(self, index: int) -> Frames:
        """Its frames."""
        return self.made[index][1]
