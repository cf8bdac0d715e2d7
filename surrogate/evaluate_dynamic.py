"""Methods on a corpus' sequences: Eq. 21 over each method's static answers, beside dynamic projective dynamics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Protocol

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.base.progress import OnProgress, silent
from ..reference import Parameters
from ..reference.face.dynamics import extrapolate_turns
from .corpus.face import Face
from .corpus.mixture import NAMES, basis
from .corpus.plan import RATE, Split
from .corpus.reading import Faces, Row, Table
from .dynamics import OSCILLATION, DynamicRig, Looseness, Swing
from .evaluate import Cost, Named, Score, score_of
from .heads import Heads
from .methods import Method


class PlaysSequences(Named, Protocol):
    """A method that learns from sequences, and plays them."""

    def fit(self, table: Table) -> None:
        """Learn from a corpus' sequences."""
        ...

    def play(self, row: Row) -> Floats32:
        """T - S [mm], shape (L, n, 3), of a sequence."""
        ...


DYNAMIC, STILL = "dynamic", "dynamic, by its static answer"


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

    heads: of the corpus' people. A sequence begins at the method's own static answer with the velocity that
    the simulation had, and its head turns alike. Raises InputError where no sequence of the split has derivatives, and
    what `Table` raises.
    """
    faces, table = Faces(folder, split, partial=partial), Table(folder, "sequences", split, partial=partial)
    rows = {key: index for index, key in enumerate(map(tuple, faces.groups.tolist()))}
    pairs = [(k, rows[key]) for k, key in enumerate(map(tuple, table.groups.tolist())) if key in rows]
    if not pairs:
        raise InputError(f"corpus {folder}: no sequence of the {split or 'whole'} split is of a face with derivatives")
    scores = []
    for number, method in enumerate(methods):
        played = [_played(method, table, k, faces.face(row), heads, looseness) for k, row in pairs]
        motion = np.concatenate([one.motion for one in played])
        for kind in (DYNAMIC, STILL):
            errors = np.concatenate([one.errors[kind] for one in played])
            frame = 1e3 * float(np.median([one.frame[kind] for one in played]))
            scores.append(score_of(method, kind, errors, motion, Cost(frame_ms=frame), faces=len(pairs)))
        on_progress(f"evaluate, dynamic: {method.name}", (number + 1) / len(methods))
    return scores


def evaluate_sequences(
    method: PlaysSequences,
    folder: str | PathLike[str],
    heads: Heads,
    *,
    partial: bool = False,
    on_progress: OnProgress = silent,
) -> Score:
    """Tell the score, of kind DYNAMIC, of a method that learns sequences alone: fitted to those of training people.

    It begins with the two skins that the simulation had before. Raises what `Table` raises.
    """
    begin = time.process_time()
    method.fit(Table(folder, "sequences", "train", partial=partial))
    fitted = time.process_time() - begin
    table = Table(folder, "sequences", "test", partial=partial)
    errors, motions, times = [], [], []
    for k in range(len(table)):
        row, identity = table[k], int(table.rows[k, 0])
        face = Face(identity, table.person(identity), table.parameters(k), np.zeros((0, 3)))
        begin = time.process_time()
        found = method.play(row)
        times.append((time.process_time() - begin) / len(found))
        truth = row["corrected"].astype(np.float32)
        errors.append(np.linalg.norm(found - truth, axis=2))
        motions.append(np.linalg.norm(truth - heads.carry(face), axis=2))
    on_progress(f"evaluate, dynamic: {method.name}", 1.0)
    cost = Cost(fit_seconds=fitted, frame_ms=1e3 * float(np.median(times)))
    return score_of(method, DYNAMIC, np.concatenate(errors), np.concatenate(motions), cost, faces=len(table))


@dataclass(frozen=True, eq=False)
class _Played:
    """Distances (frames, n) [mm] by kind, |T - carried(S)| (frames, n) [mm], and seconds of a frame by kind."""

    errors: dict[str, Floats]
    motion: Floats
    frame: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Answers:
    """Static answers (F, n, 3) [mm] that are there already, as a rig that has them one after another."""

    skins: Floats32

    def frame(self, weights, blended=None, *, out=None) -> Floats32:
        """The skin of frame number `weights`."""
        return self.skins[weights].copy()


def _played(method: Method, table: Table, number: int, face: Face, heads: Heads, looseness: Looseness) -> _Played:
    row, skin, shapes = table[number], table.skin(face.identity), table.shapes(face.identity)
    bound = method.bind(face)
    begin = time.process_time()
    corrected = np.concatenate([bound(weights[None]) for weights in row["weights"]])
    static = (time.process_time() - begin) / len(corrected)
    blended = (skin.vertices + np.tensordot(row["weights"], shapes, axes=1)).astype(np.float32)
    swing = _swing(face, row, table.template.mean, looseness)
    moving = DynamicRig(_Answers(blended + corrected), swing, 1.0 / RATE)
    turned = row["rotations"].astype(np.float64)
    velocity = RATE * (row["before"][0].astype(np.float64) - row["before"][1])
    moving.begin(0, velocity=velocity, base=extrapolate_turns(turned))
    begin = time.process_time()
    swung = np.stack([moving.frame(k, base=base) for k, base in enumerate(turned)])
    dynamic = static + (time.process_time() - begin) / len(corrected)
    truth = row["corrected"].astype(np.float32)
    return _Played(
        errors={
            DYNAMIC: np.linalg.norm(swung - blended - truth, axis=2),
            STILL: np.linalg.norm(corrected - truth, axis=2),
        },
        motion=np.linalg.norm(truth - heads.carry(face), axis=2),
        frame={DYNAMIC: dynamic, STILL: static},
    )


def _swing(face: Face, row: Row, mean: Surface, looseness: Looseness) -> Swing:
    """The person's looseness, with the frequency and damping of the sequence's parameters at the vertices."""
    waves = basis(mean.vertices)
    values = []
    for name in OSCILLATION:
        field = np.clip(waves @ row["coefficients"][NAMES.index(name)].astype(np.float64), -1.0, 1.0)
        values.append(np.asarray(Parameters.info(name).denormalise(field)))
    loose, pivot = looseness.at(face.code)
    return Swing(loose, values[0], values[1], pivot)
