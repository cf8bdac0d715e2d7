"""Methods on a corpus' sequences: Eq. 21 over each method's static answers, beside dynamic projective dynamics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Protocol

import numpy as np

from ..lhm.errors import InputError
from ..lhm.mesh import Floats, Floats32, Surface
from ..lhm.progress import OnProgress, silent
from ..reference import Parameters
from ..reference.face.base import turns_before
from .corpus.fields import basis
from .corpus.mixture import NAMES
from .corpus.plan import RATE, Split
from .corpus.reading import Row, Table
from .dynamics import OSCILLATION, DynamicRig, Swing
from .evaluate import Named, Score, score_of
from .modal.faces import Face, Faces
from .modal.looseness import Looseness
from .rivals import Method


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
    looseness: Looseness,
    *,
    partial: bool = False,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Scores of each method, which is fitted, over all frames of the sequences: of kinds DYNAMIC, and STILL.

    A sequence begins at the method's own static answer with the velocity that the simulation had, and its head turns
    alike. Raises InputError where no sequence of the split has derivatives, and what `Table` raises.
    """
    faces, table = Faces(folder, split, partial=partial), Table(folder, "sequences", split, partial=partial)
    rows = {key: index for index, key in enumerate(map(tuple, faces.groups.tolist()))}
    pairs = [(k, rows[key]) for k, key in enumerate(map(tuple, table.groups.tolist())) if key in rows]
    if not pairs:
        raise InputError(f"corpus {folder}: no sequence of the {split or 'whole'} split is of a face with derivatives")
    scores = []
    for number, method in enumerate(methods):
        played = [_played(method, table, k, faces.face(row), looseness) for k, row in pairs]
        motion = np.concatenate([one.motion for one in played])
        bind = 1e3 * float(np.median([one.bind for one in played]))
        for kind in (DYNAMIC, STILL):
            errors = np.concatenate([one.errors[kind] for one in played])
            frame = 1e3 * float(np.median([one.frame[kind] for one in played]))
            scores.append(score_of(method, kind, errors, motion, (None, bind, frame)))
        on_progress(f"evaluate, dynamic: {method.name}", (number + 1) / len(methods))
    return scores


def evaluate_sequences(
    method: PlaysSequences, folder: str | PathLike[str], *, partial: bool = False, on_progress: OnProgress = silent
) -> Score:
    """The score, of kind DYNAMIC, of a method that learns sequences alone: fitted to those of training people.

    It begins with the two skins that the simulation had before. Raises what `Table` raises.
    """
    begin = time.perf_counter()
    method.fit(Table(folder, "sequences", "train", partial=partial))
    fitted = time.perf_counter() - begin
    table = Table(folder, "sequences", "test", partial=partial)
    errors, motions, times = [], [], []
    for k in range(len(table)):
        row = table[k]
        begin = time.perf_counter()
        found = method.play(row)
        times.append((time.perf_counter() - begin) / len(found))
        truth = row["corrected"].astype(np.float32)
        errors.append(np.linalg.norm(found - truth, axis=2))
        motions.append(np.linalg.norm(truth, axis=2))
    on_progress(f"evaluate, dynamic: {method.name}", 1.0)
    costs = fitted, None, 1e3 * float(np.median(times))
    return score_of(method, DYNAMIC, np.concatenate(errors), np.concatenate(motions), costs)


@dataclass(frozen=True, eq=False)
class _Played:
    """Distances (frames, n) [mm] by kind, motion (frames, n) [mm] of the truth, seconds of a bind and of a frame."""

    errors: dict[str, Floats]
    motion: Floats
    bind: float
    frame: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Answers:
    """Static answers (F, n, 3) [mm] that are there already, as a rig that has them one after another."""

    skins: Floats32

    def frame(self, weights, blended=None, *, out=None) -> Floats32:
        """The skin of frame number `weights`."""
        return self.skins[weights].copy()


def _played(method: Method, table: Table, number: int, face: Face, looseness: Looseness) -> _Played:
    row, skin, shapes = table[number], table.skin(face.identity), table.shapes(face.identity)
    begin = time.perf_counter()
    bound = method.bind(face)
    bind = time.perf_counter() - begin
    begin = time.perf_counter()
    corrected = bound(row["weights"])
    static = (time.perf_counter() - begin) / len(corrected)
    blended = (skin.vertices + np.tensordot(row["weights"], shapes, axes=1)).astype(np.float32)
    swing = _swing(face, row, table.template.mean, looseness)
    moving = DynamicRig(_Answers(blended + corrected), swing, 1.0 / RATE)
    turned = row["rotations"].astype(np.float64)
    velocity = RATE * (row["before"][0].astype(np.float64) - row["before"][1])
    moving.begin(0, velocity=velocity, base=turns_before(turned))
    begin = time.perf_counter()
    swung = np.stack([moving.frame(k, base=base) for k, base in enumerate(turned)])
    dynamic = static + (time.perf_counter() - begin) / len(corrected)
    truth = row["corrected"].astype(np.float32)
    return _Played(
        errors={
            DYNAMIC: np.linalg.norm(swung - blended - truth, axis=2),
            STILL: np.linalg.norm(corrected - truth, axis=2),
        },
        motion=np.linalg.norm(truth, axis=2),
        bind=bind,
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
