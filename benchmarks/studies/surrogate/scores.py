"""A corpus in the contest: its faces are cases, its own skins are a truth, and rows are scored by groups of frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ....lhm.base.errors import InputError
from ....surrogate.corpus.face import KeptFace
from ....surrogate.methods import Method
from ....surrogate.motion import Plays, move, play_sequence
from ....surrogate.rigs.inertia import Looseness
from ....surrogate.ruler import KINDS, STRENGTHS, kind_of_coefficients, strength_of
from ....surrogate.trials import AGAINST, SIMULATOR, CorpusTrials, Trial, play
from ...contest import Case, Summary, compare_skins, run_contest, summarise

CORPUS = "the corpus"
"""The truth: skins that a corpus keeps."""
ALL, UNSCALED, VARYING = "all", "no bone scaled", "p varying over the face"
GROUPS = (ALL, *KINDS, UNSCALED, VARYING, *STRENGTHS)
DYNAMIC, STILL = "dynamic", "dynamic, by its static answer"
Line = Mapping[str, Any]
"""A method's score on a group of frames, as results have it: `score` says its keys."""


def run_trials(trials: Iterable[Trial], *methods: Method | Callable[[Trial], Method]) -> list[dict[str, Any]]:
    """Run methods, or what makes one of a trial, on trials: rows of the contest, each with its frame's groups."""
    rows: list[dict[str, Any]] = []
    for trial in trials:
        face = trial.face
        kind, varies = kind_of_coefficients(face.coefficients), bool(face.coefficients[:, 1:].any())
        case = Case(f"{trial.part} {trial.number}", kind, partial(replace, face), trial.weights)
        truth = play(CORPUS, trial, partial(iter, trial.truth))
        known = [each if isinstance(each, Method) else each(trial) for each in methods]
        always = {ALL, kind, trial.part, VARYING if varies else "", "" if face.carried.any() else UNSCALED}
        for row in run_contest(case, known, [truth], compare=partial(compare_skins, whole=True)):
            if row["method"] != CORPUS:
                of_frame = strength_of(trial.weights[row["frame"]])
                rows.append(row | {"number": trial.number, "groups": always | {of_frame}})
    return rows


def score(rows: Sequence[Mapping], names: Mapping[str, str]) -> list[dict[str, Any]]:
    """Score each method on groups of frames, under the groups' names: keys of `ruler.Ruler`, counts and costs.

    everywhere [mm]: mean distance over all vertices. frame_ms: of the same frames. Other costs are None, see
    `measure_wait`. Groups in which nothing moves are left out. InputError for a frame that was not made, and where
    simulation moves no frame of ALL, or there is none.
    """
    if not rows:
        raise InputError("the faces have no accepted frames; make more of the corpus, or another split")
    for row in rows:
        if row["status"] != "done":
            raise InputError(f"{row['method']}: {row['reason']}")
    lines = []
    for group, name in names.items():
        there = [row for row in rows if group in row["groups"]]
        for method, found in summarise(there, "method", CORPUS).items():
            if not np.isfinite(found.mean):
                if group == ALL:
                    raise InputError("simulation moves no frame of these faces beyond their bones")
                continue
            errors = np.concatenate([row["to"][CORPUS]["errors"] for row in there if row["method"] == method])
            counts = {"frames": len(found.frames), "faces": len({case for case, _ in found.frames})}
            distances = {key: getattr(found, key) for key in ("mean", "moved", "share", "largest", "everywhere")}
            lines.append(
                {"method": method, "kind": name, **counts, **distances, "p95": float(np.percentile(errors, 95.0)),
                 "fit_seconds": None, "head_ms": None, "bind_ms": None, "frame_ms": 1e3 * found.frame}
            )  # fmt: skip
    return lines


def score_moved(method: Method, tested: CorpusTrials, looseness: Looseness) -> list[dict[str, Any]]:
    """Score a method on sequences: by Eq. 21 over its answers, and by these alone."""
    by_inertia = run_trials(tested.moving(), lambda trial: move(method, trial, looseness, tested.faces.mean))
    return score(by_inertia, {ALL: DYNAMIC}) + score(run_trials(tested.moving(), method), {ALL: STILL})


def score_played(name: str, method: Plays, tested: CorpusTrials) -> list[dict[str, Any]]:
    """Score a method that plays whole sequences, fitted; it begins with two true skins."""
    table = tested.table("sequences")
    rows = run_trials(tested.moving(), lambda trial: play_sequence(name, method, trial, table))
    frame_ms = 1e3 * sum({row["case"]: row["bind_s"] for row in rows}.values()) / len(rows)
    return [line | {"frame_ms": frame_ms} for line in score(rows, {ALL: DYNAMIC})]


def score_referenced(method: Method | None, tested: CorpusTrials) -> list[dict[str, Any]]:
    """Score a method, or with None projective dynamics' own answers, against FEniCSx, by law."""
    simulated = (lambda trial: play(SIMULATOR, trial, lambda: trial.simulated)) if method is None else method
    return score(run_trials(tested.by_fenicsx(), simulated), {part: part for part in AGAINST.values()})


def measure_wait(method: Method, faces: Sequence[KeptFace]) -> Summary | None:
    """Measure what a user waits for before the first frame, on faces of which nothing is kept; None without heads.

    Heads are fitted, and the simulator runs, where the method needs them. The first face is not counted.
    """
    cases = []
    try:
        for number, face in enumerate(kept.without_kept() for kept in (faces[0], *faces)):
            begin = time.process_time()
            if method.needs != "nothing":
                _ = face.live
            head_s = time.process_time() - begin
            cases.append(Case(str(number), "", partial(replace, face), np.zeros((1, 52)), head_s))
    except InputError:
        return None  # nobody fits these people's heads
    rows = [row for case in cases[1:] for row in run_contest(case, [method], [], warm=cases[0])]
    return summarise(rows, "method").get(method.name)
