"""Methods on a corpus' sequences: Eq. 21 over each method's static answers, beside dynamic projective dynamics."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Protocol

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats32, Surface
from ..lhm.base.progress import OnProgress, silent
from ..reference import Parameters
from ..reference.face.dynamics import extrapolate_turns
from .corpus.face import Face
from .corpus.mixture import NAMES, basis
from .corpus.plan import RATE, Split
from .corpus.reading import Faces, Row, Table
from .dynamics import OSCILLATION, DynamicRig, Looseness, Swing, Swings
from .evaluate import Answers, Contender, Named, Score, Static, Trial, measure_frames
from .heads import Heads
from .methods import Method, NetworkMethod

DYNAMIC, STILL = "dynamic", "dynamic, by its static answer"


class InMotion(Contender):
    """Eq. 21 over a method's static answers, begun as the simulation was, each face by its `swing`."""

    def __init__(self, static: Static, swing: Callable[[Face], Swings]):
        super().__init__(static.name, simulates=static.simulates)
        self._static, self._swing = static, swing

    def answer(self, trial: Trial) -> Answers:
        """Begin at the method's own static answer with the simulation's velocity; the head turns as in the sequence."""
        row, still = trial.sequence, self._static.answer(trial)
        assert row is not None
        blended = (trial.face.skin + np.tensordot(trial.weights, trial.face.shapes, axes=1)).astype(np.float32)
        moving = DynamicRig(_Skins(blended + still.corrected), self._swing(trial.face), 1.0 / RATE)
        turned = row["rotations"].astype(np.float64)
        velocity = RATE * (row["before"][0].astype(np.float64) - row["before"][1])
        moving.begin(0, velocity=velocity, base=extrapolate_turns(turned))
        begin = time.process_time()
        swung = np.stack([moving.frame(k, base=base) for k, base in enumerate(turned)])
        each = (time.process_time() - begin) / len(swung)
        return Answers(swung - blended, None, [seconds + each for seconds in still.frame_seconds])


def swing_of_loose(looseness: Looseness, mean: Surface, face: Face) -> Swing:
    """Combine a person's looseness with p's frequency and damping at the vertices of a `mean` skin."""
    waves, values = basis(mean.vertices), []
    for name in OSCILLATION:
        row = face.parameters.coefficients[NAMES.index(name)].astype(np.float64)
        values.append(np.asarray(Parameters.info(name).denormalise(np.clip(waves @ row, -1.0, 1.0))))
    loose, pivot = looseness.at(face.code)
    return Swing(loose, values[0], values[1], pivot)


def swings_of(method: Method, looseness: Looseness, mean: Surface) -> Callable[[Face], Swings]:
    """Return how faces swing for a method: as it has learned, or by looseness."""
    learned = method.swing if isinstance(method, NetworkMethod) else None

    def swing(face: Face) -> Swings:
        own = None if learned is None else learned(face)
        return swing_of_loose(looseness, mean, face) if own is None else own

    return swing


@dataclass(frozen=True, eq=False)
class _Skins:
    """Static skins (F, n, 3) [mm] that are there already, as a rig whose weights are a frame's number."""

    skins: Floats32

    def frame(self, weights, blended=None, *, out=None) -> Floats32:
        """Return the skin of frame number `weights`."""
        return self.skins[weights].copy()


class PlaysSequences(Named, Protocol):
    """A method that learns from sequences, and plays them."""

    def fit(self, table: Table) -> None:
        """Learn from a corpus' sequences."""
        ...

    def play(self, row: Row, table: Table) -> Floats32:
        """Return T - S [mm], shape (L, n, 3), of a sequence of a table."""
        ...


class Player(Contender):
    """A method that plays whole sequences of a table, fitted."""

    def __init__(self, method: PlaysSequences, table: Table):
        super().__init__(method.name, simulates=method.simulates)
        self._method, self._table = method, table

    def answer(self, trial: Trial) -> Answers:
        """Play the trial's sequence."""
        assert trial.sequence is not None
        begin = time.process_time()
        corrected = self._method.play(trial.sequence, self._table)
        return Answers(corrected, None, [(time.process_time() - begin) / len(corrected)] * len(corrected))


def sequence_trials(table: Table, heads: Heads, faces: Faces | None = None) -> Iterator[Trial]:
    """Read the sequences of a table; with `faces`, only those of these faces, with derivatives."""
    number_of = None if faces is None else {key: k for k, key in enumerate(map(tuple, faces.groups.tolist()))}
    for k, key in enumerate(map(tuple, table.groups.tolist())):
        if faces is not None and number_of is not None:
            if key not in number_of:
                continue
            face = faces.face(number_of[key])
        else:
            face = Face(key[0], table.person(key[0]), table.parameters(k), table.settled(*key))
        row = table[k]
        yield Trial(face, row["weights"], row["corrected"].astype(np.float32), heads.carry(face), DYNAMIC, row)


def evaluate_dynamic(
    methods: Sequence[Method],
    folder: str | PathLike[str],
    split: Split | None,
    heads: Heads,
    looseness: Looseness,
    *,
    partial: bool = False,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Score each method, which is fitted, over all frames of the sequences: of kinds DYNAMIC, and STILL.

    A network with learned coefficients moves by these, all others by `looseness`. heads: of the corpus' people. Raises
    InputError where no sequence of the split has derivatives, and what `Table` raises.
    """
    faces, table = Faces(folder, split, partial=partial), Table(folder, "sequences", split, partial=partial)
    if not set(map(tuple, faces.groups.tolist())) & set(map(tuple, table.groups.tolist())):
        raise InputError(f"corpus {folder}: no sequence of the {split or 'whole'} split is of a face with derivatives")
    still = [Static(method) for method in methods]
    swings = [swings_of(method, looseness, table.mean) for method in methods]
    moving = [InMotion(static, swing) for static, swing in zip(still, swings, strict=True)]
    distances = measure_frames([*moving, *still], sequence_trials(table, heads, faces), on_progress)
    scores = distances.scores(distances.parts())
    return scores[: len(moving)] + [replace(score, kind=STILL) for score in scores[len(moving) :]]


def evaluate_sequences(
    method: PlaysSequences,
    folder: str | PathLike[str],
    heads: Heads,
    *,
    partial: bool = False,
    on_progress: OnProgress = silent,
) -> Score:
    """Score a method that learns sequences alone, of kind DYNAMIC: fitted to those of training people.

    It begins with the two skins that the simulation had before. Raises what `Table` raises.
    """
    begin = time.process_time()
    method.fit(Table(folder, "sequences", "train", partial=partial))
    fitted = time.process_time() - begin
    table = Table(folder, "sequences", "test", partial=partial)
    distances = measure_frames([Player(method, table)], sequence_trials(table, heads), on_progress)
    (score,) = distances.scores(distances.parts(), fits=[fitted])
    return score
