"""Methods on a corpus' sequences: Eq. 21 over each method's static answers, beside dynamic projective dynamics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ..lhm.base.mesh import Floats32, Surface
from ..reference import Parameters
from ..reference.face.dynamics import OSCILLATION, Swing, extrapolate_turns
from .corpus.face import KeptFace
from .corpus.mixture import NAMES, basis
from .corpus.plan import RATE
from .corpus.reading import Row, Table
from .evaluate import Answers, Contender, Score, Trial, by_frame, measure_frames
from .methods import Method
from .rigs.inertia import DynamicRig, Looseness
from .rigs.rig import Needs
from .trials import CorpusTrials

STILL = "dynamic, by its static answer"


def in_motion(method: Method, looseness: Looseness, mean: Surface) -> Contender:
    """Answer with Eq. 21 over a method's frames, by the swing that its rig has learned, or where people are loose.

    A sequence begins at the method's own static answer with the simulation's velocity; the head turns as it did there.
    """

    def answer(trial: Trial) -> Answers:
        face, row = trial.face, trial.sequence
        assert row is not None
        rig = method.bind(face)
        learned = getattr(rig, "swing", None)
        swing = swing_where_loose(looseness, face, mean) if learned is None else learned
        moving = DynamicRig(rig, swing, 1.0 / RATE)
        turned = row["rotations"].astype(np.float64)
        velocity = RATE * (row["before"][0].astype(np.float64) - row["before"][1])
        moving.begin(trial.weights[0], velocity=velocity, base=extrapolate_turns(turned))
        skins, seconds = [], []
        for weights, base in zip(trial.weights, turned, strict=True):
            begin = time.process_time()
            skins.append(moving.frame(weights, base=base))
            seconds.append(time.process_time() - begin)
        return Answers(np.stack(skins) - face.blend(trial.weights).astype(np.float32), None, seconds)

    return Contender(method.name, answer, method.needs)


def swing_where_loose(looseness: Looseness, face: KeptFace, mean: Surface) -> Swing:
    """Combine a person's looseness with p's frequency and damping at the vertices of a space's `mean` skin."""
    waves, values = basis(mean.vertices), []
    for name in OSCILLATION:
        row = face.parameters.coefficients[NAMES.index(name)].astype(np.float64)
        values.append(np.asarray(Parameters.info(name).denormalise(np.clip(waves @ row, -1.0, 1.0))))
    loose, pivot = looseness.predict(face.code)
    return Swing(loose, values[0], values[1], pivot)


class Plays(Protocol):
    """A method that learns from sequences, and plays them."""

    needs: Needs

    def fit(self, table: Table) -> None:
        """Learn from a corpus' sequences."""
        ...

    def play(self, row: Row, table: Table) -> Floats32:
        """Return T - S [mm], shape (L, n, 3), of a sequence of a table."""
        ...


def as_played(name: str, method: Plays, table: Table) -> Contender:
    """Answer with a method that plays whole sequences of a table, fitted."""

    def answer(trial: Trial) -> Answers:
        assert trial.sequence is not None
        begin = time.process_time()
        corrected = method.play(trial.sequence, table)
        return Answers(corrected, None, [(time.process_time() - begin) / len(corrected)] * len(corrected))

    return Contender(name, answer, method.needs)


def evaluate_motion(methods: Sequence[Method], tested: CorpusTrials, looseness: Looseness) -> list[Score]:
    """Score each method, which is ready, over all frames of the sequences: of kinds DYNAMIC, and STILL without inertia.

    Raises what `CorpusTrials.moving` and `measure_frames` raise.
    """
    moving = [in_motion(method, looseness, tested.faces.mean) for method in methods]
    distances = measure_frames([*moving, *map(by_frame, methods)], tested.moving())
    scores = distances.scores(distances.parts())
    return scores[: len(moving)] + [replace(score, kind=STILL) for score in scores[len(moving) :]]


def evaluate_played(name: str, method: Plays, tested: CorpusTrials) -> Score:
    """Score a method that learns sequences alone, of kind DYNAMIC: fitted to those of training people.

    It begins with the two skins that the simulation had before. Raises what `Table` raises.
    """
    begin = time.process_time()
    method.fit(tested.table("sequences", "train"))
    fitted = time.process_time() - begin
    trials = tested.moving(only_differentiated=False)
    distances = measure_frames([as_played(name, method, tested.table("sequences"))], trials)
    (score,) = distances.scores(distances.parts())
    return replace(score, fit_seconds=fitted)
