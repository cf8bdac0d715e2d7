"""Table 1 again: methods on faces that training has not seen, error against the cost at bind and per frame."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..lhm.errors import InputError
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress, silent
from .modal.faces import Face, Faces, Frames
from .rivals import Method

Times = tuple[float | None, float | None, float | None]
"""Seconds of a fit, milliseconds of a bind and of a frame, those that were measured."""
MOVES = 0.1
"""[mm] |T - S| from which on a vertex counts as one that moves."""
VARYING = "p varying over the face"


@dataclass(frozen=True)
class Score:
    """One method on some frames: distances of vertices to the simulator's [mm], and its costs.

    mean, p95, largest: over all vertices of all frames; moving: mean over vertices that simulation moves by more than
    MOVES; share: mean over that of T = S. fit_seconds, bind_ms, frame_ms: medians on one thread, None where another
    kind has them; of a method that `simulates`, bind_ms is without the simulator's part.
    """

    method: str
    kind: str
    frames: int
    mean: float
    p95: float
    largest: float
    moving: float
    share: float
    simulates: bool
    fit_seconds: float | None
    bind_ms: float | None
    frame_ms: float | None


class Tests(Protocol):
    """Faces with static frames, such as `Faces`."""

    def __len__(self) -> int: ...

    def face(self, index: int) -> Face:
        """One of them."""
        ...

    def frames(self, index: int) -> Frames:
        """Its frames, which may be none."""
        ...


def evaluate(
    methods: Sequence[Method],
    test: Tests,
    training: Faces | None = None,
    *,
    chosen: Sequence[int] | None = None,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Scores of each method over all static frames of the test faces, and per kind of parameters ("all" first).

    Kind VARYING has the faces, of whatever other kind, whose p is not the same everywhere.

    `training` faces fit what is not fitted yet; None for methods that need none. `chosen`: of the test faces, those of
    these numbers alone.
    """
    scores = []
    for number, method in enumerate(methods):
        fit_seconds = 0.0
        if training is not None:
            begin = time.perf_counter()
            method.fit(training)
            fit_seconds = time.perf_counter() - begin
        scores += _scores(method, test, range(len(test)) if chosen is None else chosen, fit_seconds)
        on_progress(f"evaluate: {method.name}", (number + 1) / len(methods))
    return scores


def _scores(method: Method, test: Tests, chosen: Sequence[int], fit_seconds: float) -> list[Score]:
    kinds, varying, errors, motions, binding, framing = [], [], [], [], [], []
    for index in chosen:
        face, frames = test.face(index), test.frames(index)
        if not len(frames.weights):
            continue
        begin = time.perf_counter()
        bound = method.bind(face)
        binding.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        answer = bound(frames.weights)
        framing.append((time.perf_counter() - begin) / len(frames.weights))
        truth = frames.corrected.astype(np.float32)
        errors.append(np.linalg.norm(answer - truth, axis=2))
        motions.append(np.linalg.norm(truth, axis=2))
        kinds += [face.kind] * len(frames.weights)
        varying += [bool(face.coefficients[:, 1:].any())] * len(frames.weights)
    if not errors:
        raise InputError(
            "evaluate: the faces have no accepted static frames; make more of the corpus, or another split"
        )
    error, motion, kind = np.concatenate(errors), np.concatenate(motions), np.array(kinds)
    times: Times = fit_seconds, 1e3 * float(np.median(binding)), 1e3 * float(np.median(framing))
    parts = {"all": np.ones(len(kind), dtype=bool)} | {name: kind == name for name in sorted(set(kinds))}
    if any(varying):
        parts[VARYING] = np.array(varying)
    return [score_of(method, name, error[rows], motion[rows], times) for name, rows in parts.items()]


class Named(Protocol):
    """What a score says of its method."""

    name: str
    simulates: bool


def score_of(method: Named, kind: str, error: Floats, motion: Floats, times: Times) -> Score:
    """Return the score of distances of vertices to the truth (frames, n) [mm], and of that to the blendshapes.

    Raises InputError where there is no frame, where nothing moves, and for numbers that are not finite.
    """
    if not len(error) or not motion.any() or not (np.isfinite(error).all() and np.isfinite(motion).all()):
        why = "numbers that are not finite" if motion.any() else "no frame that simulation moves"
        raise InputError(f"evaluate: {method.name}, {kind}: {why}")
    moves = motion > MOVES
    return Score(
        method=method.name,
        kind=kind,
        frames=len(error),
        mean=float(error.mean()),
        p95=float(np.percentile(error, 95.0)),
        largest=float(error.max()),
        moving=float(error[moves].mean()) if moves.any() else float("nan"),
        share=float(error.mean() / motion.mean()),
        simulates=method.simulates,
        fit_seconds=times[0],
        bind_ms=times[1],
        frame_ms=times[2],
    )
