"""Methods, and the simulator itself, against what FEniCSx says of a corpus' frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.base.progress import OnProgress, silent
from .corpus.plan import Split
from .corpus.reading import Faces, Table
from .corpus.references import FEM_LAWS
from .evaluate import Named, Score, score_of
from .heads import Heads
from .methods import Bound, Method

KINDS = {law: f"against FEniCSx, {law}" for law in FEM_LAWS}


class _Simulator:
    def __init__(self):
        self.name, self.simulates = "projective dynamics", True


@dataclass(frozen=True, eq=False)
class Referenced:
    """A frame with an answer of FEniCSx: weights (52,), and T - S (n, 3) [mm] `simulated` by PD and of FEniCSx' `law`.

    face: which of the corpus' faces it is of.
    """

    law: str
    face: int
    weights: Floats32
    simulated: Floats32
    fenicsx: Floats32


def referenced(
    folder: str | PathLike[str], split: Split | None, faces: Faces, *, partial: bool = False
) -> Iterator[Referenced]:
    """All frames of `faces` that FEniCSx solved, too, one after another; raises what `Table` raises."""
    table, statics = (Table(folder, name, split, partial=partial) for name in ("references", "statics"))
    face_of = {key: index for index, key in enumerate(map(tuple, faces.groups.tolist()))}
    static_of = {key: index for index, key in enumerate(map(tuple, statics.rows.tolist()))}
    for row in (table[k] for k in range(len(table))):
        index = static_of.get((int(row["identity"]), int(row["static"])))
        if index is None:
            continue
        static = statics[index]
        face = face_of.get((int(row["identity"]), int(static["group"])))
        if face is not None:
            simulated, truth = (one["corrected"].astype(np.float32) for one in (static, row))
            yield Referenced(row["law"].decode(), face, static["weights"], simulated, truth)


def evaluate_references(
    methods: Sequence[Method],
    folder: str | PathLike[str],
    split: Split | None,
    heads: Heads,
    *,
    partial: bool = False,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Score projective dynamics and each method, which is fitted, by law (KINDS), without costs.

    heads: of the corpus' people. T is what FEniCSx says. Raises InputError where no frame with references
    has derivatives, and what `Table` raises.
    """
    faces = Faces(folder, split, partial=partial)
    scores: list[Score] = []

    @lru_cache(maxsize=4 * len(methods))
    def bound(method: int, index: int) -> Bound:
        return methods[method].bind(faces.face(index))

    @lru_cache(maxsize=4)
    def carried(index: int) -> Floats32:
        return heads.carry(faces.face(index))

    for law, kind in KINDS.items():
        answers: dict[str, list[Floats]] = {}
        motions: list[Floats] = []
        seen: set[int] = set()
        for frame in referenced(folder, split, faces, partial=partial):
            if frame.law != law:
                continue
            seen.add(frame.face)
            motions.append(np.linalg.norm(frame.fenicsx - carried(frame.face), axis=1))
            answers.setdefault(_Simulator().name, []).append(np.linalg.norm(frame.simulated - frame.fenicsx, axis=1))
            for number, method in enumerate(methods):
                own = bound(number, frame.face)(frame.weights[None])[0]
                answers.setdefault(method.name, []).append(np.linalg.norm(own - frame.fenicsx, axis=1))
            on_progress(f"evaluate, {kind}: frame {len(motions)}", 0.0)
        if not motions:
            raise InputError(f"corpus {folder}: no frame with an answer of {law} has derivatives")
        named: list[Named] = [_Simulator(), *methods]
        motion: Floats = np.stack(motions)
        scores += [score_of(one, kind, np.stack(answers[one.name]), motion, faces=len(seen)) for one in named]
        on_progress(f"evaluate, {kind}", 1.0)
    return scores
