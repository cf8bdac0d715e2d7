"""Methods on faces that training has not seen: errors by the ruler, and what a user waits for."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Protocol

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.base.progress import OnProgress, silent
from .corpus.face import Face, Frames
from .corpus.reading import Faces
from .heads import BindCosts, Heads
from .methods import Bound, Method, Takes
from .ruler import KINDS, STRENGTHS, kind_of_coefficients, measure, strength_of

ALL, VARYING = "all", "p varying over the face"
UNSCALED = "no bone scaled"


@dataclass(frozen=True)
class Cost:
    """What a user waits for, as processor time of one thread; None where it was not measured.

    fit_seconds: learning. head_ms: fitting a person's head, where the method needs one. bind_ms: all that one person
    and p need besides, the simulator's part included. frame_ms: one frame at a time, with its blendshapes.
    """

    fit_seconds: float | None = None
    head_ms: float | None = None
    bind_ms: float | None = None
    frame_ms: float | None = None


@dataclass(frozen=True)
class Score(Cost):
    """One method on some frames of one or more `faces`: distances of the skin to the simulator's, and its costs.

    mean, p95, largest, moved, share, vertices: see `ruler.Ruler`, over vertices that |T - carried(S)| moves. everywhere
    [mm]: mean distance over all vertices. simulates: whether the simulator runs at bind or in each frame.
    """

    method: str = ""
    kind: str = ALL
    frames: int = 0
    faces: int = 0
    mean: float = np.nan
    p95: float = np.nan
    largest: float = np.nan
    moved: float = np.nan
    share: float = np.nan
    vertices: int = 0
    everywhere: float = np.nan
    simulates: bool = False


class Tests(Protocol):
    """Faces with static frames, such as `Faces`."""

    def __len__(self) -> int: ...

    def face(self, index: int) -> Face:
        """One of them."""
        ...

    def frames(self, index: int) -> Frames:
        """Its frames, which may be none."""
        ...


class Named(Protocol):
    """What a score says of its method."""

    name: str
    simulates: bool


@dataclass(frozen=True, eq=False)
class _Tally:
    """What is measured of one method: distances (frames, n) [mm] per face, and seconds."""

    errors: list[Floats32]
    binding: list[float]
    framing: list[float]


def evaluate(
    methods: Sequence[Method],
    test: Tests,
    heads: Heads,
    training: Faces | None = None,
    *,
    chosen: Sequence[int] | None = None,
    costs: BindCosts | None = None,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Score each method over all static frames of the test faces (ALL), and by kind of p and strength of expression.

    Kinds and strengths are `ruler.KINDS` and `ruler.STRENGTHS`; UNSCALED and VARYING have the faces in which no bone is
    scaled, and those whose p is not the same everywhere. Kinds in which nothing moves are left out.

    heads: of the test people. training: faces that fit what is not fitted yet; None for methods that need none.
    chosen: numbers of test faces, by default all. costs: what binds take of the simulator; without it the costs of
    methods that take something are left out. Raises InputError where a bone is scaled and nobody
    fits heads, where there is no frame, and where simulation moves none.
    """
    fits = []
    for number, method in enumerate(methods):
        begin = time.process_time()
        if training is not None:
            method.fit(training)
        fits.append(time.process_time() - begin)
        on_progress(f"fit: {method.name}", (number + 1) / len(methods))
    tallies = [_Tally([], [], []) for _ in methods]
    motions: list[Floats32] = []
    labels: list[tuple[int, str, str, bool, bool]] = []
    indices = range(len(test)) if chosen is None else chosen
    for number, index in enumerate(indices):
        face, frames = test.face(index), test.frames(index)
        if not len(frames.weights):
            continue
        carried, truth = heads.carry(face), frames.corrected.astype(np.float32)
        motions.append(np.linalg.norm(truth - carried, axis=2))
        kind, varies = kind_of_coefficients(face.coefficients), bool(face.coefficients[:, 1:].any())
        labels += [(index, kind, strength_of(w), varies, not carried.any()) for w in frames.weights]
        for method, tally in zip(methods, tallies, strict=True):
            _measure(method, face, frames.weights, truth, tally)
        on_progress("evaluate: faces", (number + 1) / len(indices))
    if not motions:
        raise InputError(
            "evaluate: the faces have no accepted static frames; make more of the corpus, or another split"
        )
    motion, parts = np.concatenate(motions), _parts(labels)
    face_of = np.array([label[0] for label in labels])
    scores = []
    for method, fitted, tally in zip(methods, fits, tallies, strict=True):
        error, cost = np.concatenate(tally.errors), _cost(method.takes, fitted, tally, costs)
        for name, rows in parts.items():
            score = score_of(method, name, error[rows], motion[rows], cost, faces=len(np.unique(face_of[rows])))
            if score.vertices:
                scores.append(score)
            elif name == ALL:
                raise InputError("evaluate: simulation moves no frame of these faces beyond their bones")
    return scores


def _measure(method: Method, face: Face, weights: Floats32, truth: Floats32, tally: _Tally) -> None:
    begin = time.process_time()
    bound = method.bind(face)
    tally.binding.append(time.process_time() - begin)
    skin, shapes = face.skin.astype(np.float32), np.asarray(face.shapes, dtype=np.float32)
    answers = []
    for row in weights:
        begin = time.process_time()
        answer = _frame(bound, row, skin, shapes)
        tally.framing.append(time.process_time() - begin)
        answers.append(answer[1])
    tally.errors.append(np.linalg.norm(np.stack(answers) - truth, axis=2).astype(np.float32))


def _frame(bound: Bound, weights: Floats32, skin: Floats32, shapes: Floats32) -> tuple[Floats32, Floats32]:
    """T and T - S [mm], (n, 3), as a user has them of one frame: with S by blendshapes."""
    corrected = bound(weights[None])[0]
    return skin + np.tensordot(weights, shapes, axes=1) + corrected, corrected


def _parts(labels: Sequence[tuple[int, str, str, bool, bool]]) -> dict[str, np.ndarray]:
    """Which frames each part has, shape (frames,), in the order of tables."""
    _, kinds, strengths, varying, unscaled = (np.array(column) for column in zip(*labels, strict=True))
    parts = {ALL: np.ones(len(labels), dtype=bool)}
    parts |= {name: kinds == name for name in KINDS}
    parts |= {UNSCALED: unscaled, VARYING: varying}
    parts |= {name: strengths == name for name in STRENGTHS}
    return {name: rows for name, rows in parts.items() if rows.any()}


def _cost(takes: Takes, fitted: float, tally: _Tally, costs: BindCosts | None) -> Cost:
    own, frame = 1e3 * float(np.median(tally.binding)), 1e3 * float(np.median(tally.framing))
    if takes == "nothing":
        return Cost(fitted, None, own, frame)
    if costs is None:
        return Cost(fitted, None, None, frame)
    # To carry the skin is what this bind does itself.
    return Cost(fitted, 1e3 * costs.head, 1e3 * costs.seconds(takes) + (0.0 if takes == "carried" else own), frame)


def score_of(
    method: Named, kind: str, error: Floats, motion: Floats, cost: Cost | None = None, *, faces: int = 1
) -> Score:
    """Score distances to T against |T - carried(S)|; both [mm], shape (frames, n).

    Raises InputError where there is no frame, and for numbers that are not finite.
    """
    if not len(error) or not (np.isfinite(error).all() and np.isfinite(motion).all()):
        why = "numbers that are not finite" if len(error) else "no frame"
        raise InputError(f"evaluate: {method.name}, {kind}: {why}")
    return Score(
        method=method.name,
        kind=kind,
        frames=len(error),
        faces=faces,
        everywhere=float(error.mean()),
        simulates=method.simulates,
        **asdict(measure(error, motion)),
        **asdict(Cost() if cost is None else cost),
    )
