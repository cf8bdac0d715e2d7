"""Generalisation by people, parameters and recordings apart: faces under every combination of known and unseen.

A corpus' test shares none of the three with training, so that its errors do not tell which of them is hard. Here those
of a pair, somebody whom the network knows and somebody of test, each take the other's parameter set too, and all four
faces make frames of recordings of training and of test: eight combinations, which differ in one thing at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from ..lhm.base.errors import InputError, SoftdecaError
from ..lhm.base.files.resumable import RowStore, lock_folder
from ..lhm.base.progress import OnProgress, silent
from .corpus.face import Derivatives, Face, Person
from .corpus.folder import describe_simulation
from .corpus.people import People
from .corpus.plan import IDENTITY, SPLITS, CorpusPlan, Split
from .corpus.shard import ACCEPTED
from .corpus.simulator import FaceSimulator
from .evaluate import Score, Static, Trial, measure_frames
from .heads import BindCosts, Heads
from .methods import Method
from .networks.weights import Weights
from .schedule import Schedule, run_items

COMBINATIONS: tuple[tuple[Split, Split, Split], ...] = tuple(product(SPLITS, SPLITS, SPLITS))
"""From which split people, parameters and recordings are."""
ALIKE = 0.05
"""By how much the mean code of a plan's people may be off the one that weights were trained on, over its spread."""


def name_unseen(combination: Sequence[Split]) -> str:
    """Name what of a combination is unseen."""
    aspects = zip(("people", "parameters", "recordings"), combination, strict=True)
    return f"unseen: {', '.join(name for name, split in aspects if split == 'test') or 'nothing'}"


KINDS = tuple(map(name_unseen, COMBINATIONS))


@dataclass(frozen=True)
class Pair:
    """Somebody known and somebody of test by their numbers, and each one's parameter set."""

    people: Mapping[Split, int]
    parameters: Mapping[Split, int]
    group: int

    @property
    def name(self) -> str:
        """The name of the file of what is simulated of the two."""
        return f"pair-{self.people['train']:05d}-{self.people['test']:05d}"


def choose_pairs(plan: CorpusPlan, weights: Weights, count: int) -> list[Pair]:
    """Return the first `count` pairs; the k-th takes the (k mod groups)-th parameter set of both.

    InputError where training or test has fewer people.
    """
    held = set(weights.note.held)
    known = [k for k in range(weights.note.people + len(held)) if k not in held]
    most = min(len(known), plan.tested)
    if not 1 <= count <= most:
        raise InputError(f"generalisation: expected 1 to {most} pairs of people, got {count}")
    chosen = []
    for number in range(count):
        people: dict[Split, int] = {"train": known[number], "test": plan.trained + number}
        group = number % plan.groups
        sets: dict[Split, int] = {split: plan.parameter_numbers(one)[group] for split, one in people.items()}
        chosen.append(Pair(people, sets, group))
    return chosen


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


def simulate_pairs(
    weights: Weights,
    plan: CorpusPlan,
    people: People,
    folder: Path,
    *,
    count: int,
    on: Schedule,
    on_progress: OnProgress = silent,
) -> PairStore:
    """Simulate what is missing of `count` pairs of people into a folder; a minute of a core each.

    Raises InputError where the weights did not learn from the plan's people, for more pairs than there are, and for a
    folder of something else.
    """
    check_learned(plan, people, weights)
    wanted = choose_pairs(plan, weights, count)
    with lock_folder(folder, "generalisation"):
        store = PairStore(plan, people, RowStore(folder, "generalisation", describe_simulation(plan, people)), wanted)
        pending = [pair for pair in wanted if not store.rows.is_whole(pair.name)]
        for done, _ in enumerate(run_items(store.simulate, pending, on=on, name="generalisation")):
            on_progress("generalisation: pairs of people simulated", (done + 1) / len(pending))
    return store


def evaluate_generalisation(
    methods: Sequence[Method], store: PairStore, costs: BindCosts | None = None, on_progress: OnProgress = silent
) -> list[Score]:
    """Score methods, which are fitted, on a store's pairs by what is unseen (KINDS).

    Raises SoftdecaError where no frame of some combination is accepted.
    """
    heads = Heads(store.people)
    trials = (trial for combination in COMBINATIONS for trial in store.trials(combination, heads))
    table = measure_frames([*map(Static, methods)], trials, on_progress)
    parts = table.parts()
    scores = table.scores(parts, costs)
    return [score for name in parts for score in scores if score.kind == name]


@dataclass(frozen=True, eq=False)
class PairStore:
    """The four faces of each pair of a plan's people, with frames of recordings of both splits."""

    plan: CorpusPlan
    people: People
    rows: RowStore
    pairs: Sequence[Pair]

    def simulate(self, pair: Pair) -> None:
        """Simulate a pair into its file."""
        arrays: dict[str, np.ndarray] = {}
        for whose, by in product(SPLITS, SPLITS):
            arrays |= {f"{whose}/{by}/{name}": values for name, values in self._simulate(pair, whose, by).items()}
        self.rows.write(pair.name, arrays)

    def _simulate(self, pair: Pair, whose: Split, by: Split) -> dict[str, np.ndarray]:
        """Simulate one face; no arrays where it has no head, or does not come to rest."""
        plan, person = self.plan, self._person(pair, whose)
        try:
            head = self.people.head(person)
            face = FaceSimulator.of(plan, self.people, person, head, plan.parameter_set(pair.parameters[by]))
        except SoftdecaError:
            return {}
        first = face.derivatives
        kept = {"settled": face.neutral.displacement, "offset": first.offset, "responses": first.responses}
        arrays: dict[str, np.ndarray] = {name: values.astype(np.float16) for name, values in kept.items()}
        for split in SPLITS:
            rows = [plan.weights(static) for static in plan.statics(pair.people[split], pair.group)]
            answers = [face.static(weights) for weights in rows]
            accepted = [k for k, answer in enumerate(answers) if answer.status == ACCEPTED]
            arrays[f"{split}/weights"] = np.array([rows[k] for k in accepted], dtype=np.float32).reshape(-1, 52)
            corrected = np.array([answers[k].corrected for k in accepted], dtype=np.float16)
            arrays[f"{split}/corrected"] = corrected.reshape(-1, *person.skin.vertices.shape)
        return arrays

    def trials(self, combination: tuple[Split, Split, Split], heads: Heads) -> Iterator[Trial]:
        """Read the frames of one combination; SoftdecaError where there are none."""
        (whose, by, of), count = combination, 0
        for pair in self.pairs:
            arrays = self.rows.read(pair.name)
            if f"{whose}/{by}/offset" not in arrays:
                continue
            names = ("settled", "offset", "responses", f"{of}/weights", f"{of}/corrected")
            settled, offset, responses, weights, corrected = (arrays[f"{whose}/{by}/{name}"] for name in names)
            drawn = self.plan.parameter_set(pair.parameters[by])
            known = Derivatives(offset, responses)
            face = Face(pair.people[whose], self._person(pair, whose), drawn, settled, known)
            count += len(weights)
            yield Trial(face, weights, corrected.astype(np.float32), heads.carry(face), name_unseen(combination))
        if not count:
            raise SoftdecaError(f"generalisation: of {name_unseen(combination)} no frame was accepted")

    def _person(self, pair: Pair, whose: Split) -> Person:
        return self.people.person(self.plan.rng(IDENTITY, pair.people[whose]))
