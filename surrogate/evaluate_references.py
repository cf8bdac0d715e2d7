"""Methods, and the simulator itself, against what FEniCSx says of a corpus' frames."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from os import PathLike

import numpy as np

from ..lhm.errors import InputError
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress, silent
from .corpus.plan import Split
from .corpus.reading import Table
from .corpus.references import FEM_LAWS
from .evaluate import Named, Score, score_of
from .modal.faces import Faces
from .rivals import Bound, Method

KINDS = {law: f"against FEniCSx, {law}" for law in FEM_LAWS}


class _Simulator:
    def __init__(self):
        self.name, self.simulates = "projective dynamics", True


def evaluate_references(
    methods: Sequence[Method],
    folder: str | PathLike[str],
    split: Split | None,
    *,
    partial: bool = False,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Scores of projective dynamics and of each method, which is fitted, by law (KINDS), without times.

    Raises InputError where no frame with references has derivatives, and what `Table` raises.
    """
    faces = Faces(folder, split, partial=partial)
    table, statics = (Table(folder, name, split, partial=partial) for name in ("references", "statics"))
    face_of = {key: index for index, key in enumerate(map(tuple, faces.groups.tolist()))}
    static_of = {key: index for index, key in enumerate(map(tuple, statics.rows.tolist()))}
    scores: list[Score] = []

    @lru_cache(maxsize=4 * len(methods))
    def bound(method: int, index: int) -> Bound:
        return methods[method].bind(faces.face(index))

    for law, kind in KINDS.items():
        answers: dict[str, list[Floats]] = {}
        motions: list[Floats] = []
        for row in (table[k] for k in range(len(table))):
            index = static_of.get((int(row["identity"]), int(row["static"])))
            if row["law"].decode() != law or index is None:
                continue
            static = statics[index]
            key = (int(row["identity"]), int(static["group"]))
            if key not in face_of:
                continue
            truth = row["corrected"].astype(np.float32)
            motions.append(np.linalg.norm(truth, axis=1))
            simulated = static["corrected"].astype(np.float32)
            answers.setdefault(_Simulator().name, []).append(np.linalg.norm(simulated - truth, axis=1))
            for number, method in enumerate(methods):
                own = bound(number, face_of[key])(static["weights"][None])[0]
                answers.setdefault(method.name, []).append(np.linalg.norm(own - truth, axis=1))
            on_progress(f"evaluate, {kind}: frame {len(motions)}", 0.0)
        if not motions:
            raise InputError(f"corpus {folder}: no frame with an answer of {law} has derivatives")
        named: list[Named] = [_Simulator(), *methods]
        motion = np.stack(motions)
        scores += [score_of(one, kind, np.stack(answers[one.name]), motion, (None, None, None)) for one in named]
        on_progress(f"evaluate, {kind}", 1.0)
    return scores
