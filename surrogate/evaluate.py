"""Methods against the simulator: a table of frames x methods, and scores of its groups.

A `Trial` has frames of one face with their truth; a `Contender` answers it (`by_frame`, or in motion). `measure_frames`
makes the table, and `Distances.scores` groups it: by kind of p, strength of the expression, or the trials' own part.
`trials` has a corpus' trials.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Protocol

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32
from .corpus.face import KeptFace
from .corpus.reading import Faces, Row
from .methods import Method
from .rigs.rig import Needs, Rig
from .ruler import KINDS, STRENGTHS, kind_of_coefficients, measure, strength_of

ALL, VARYING = "all", "p varying over the face"
UNSCALED = "no bone scaled"


@dataclass(frozen=True)
class Cost:
    """Waiting times of a user, as processor time of one thread; None where it was not measured.

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


@dataclass(frozen=True, eq=False)
class Trial:
    """Frames of one face to answer: weights (F, 52), their `truth` T - S (F, n, 3) [mm].

    part: a name that groups trials. sequence: the corpus' row where the frames follow one another. known: answers that
    are there already, by method.
    """

    face: KeptFace
    weights: Floats32
    truth: Floats32
    part: str = ALL
    sequence: Row | None = None
    known: Mapping[str, Floats32] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Answers:
    """T - S (F, n, 3) [mm] of a trial's frames, with processor seconds of the bind and of each frame, if measured."""

    corrected: Floats32
    bind_seconds: float | None = None
    frame_seconds: Sequence[float] = ()


class Learns(Protocol):
    """A method that learns from a corpus' training faces before it binds others."""

    needs: Needs

    def fit(self, faces: Faces) -> None:
        """Learn."""
        ...

    def bind(self, face: KeptFace, /) -> Rig:
        """Bind a face."""
        ...


@dataclass(frozen=True, eq=False)
class Contender:
    """Whoever answers trials, by a function; `needs`: what a bind needs."""

    name: str
    answer: Callable[[Trial], Answers]
    needs: Needs = "nothing"


def by_frame(method: Method) -> Contender:
    """Answer with a method, fitted, one frame at a time by its weights alone."""

    def answer(trial: Trial) -> Answers:
        begin = time.process_time()
        rig = method.bind(trial.face)
        binding = time.process_time() - begin
        skin, shapes = trial.face.skin.vertices.astype(np.float32), np.asarray(trial.face.shapes, dtype=np.float32)
        corrected, seconds = [], []
        for row in trial.weights:
            begin = time.process_time()
            frame = rig.frame(row)  # as a user has it: with S by blendshapes
            seconds.append(time.process_time() - begin)
            corrected.append(frame - (skin + np.tensordot(row, shapes, axes=1)))
        return Answers(np.stack(corrected), binding, seconds)

    return Contender(method.name, answer, method.needs)


@dataclass(frozen=True, eq=False)
class Distances:
    """The table: distances to T [mm] of every frame, (frames, n), by contender; motion = |T - carried(S)| likewise.

    A frame's columns: trial (its number), part, kind and strength, varies (p over the face), unscaled (no bone is).
    binds, frames: processor seconds of each, by contender.
    """

    contenders: Sequence[Contender]
    columns: Mapping[str, np.ndarray]
    motion: Floats32
    errors: Sequence[Floats32]
    binds: Sequence[Sequence[float]]
    frames: Sequence[Sequence[float]]

    def parts(self) -> dict[str, np.ndarray]:
        """Mask the frames of each of the trials' parts, in the order of the trials."""
        names = dict.fromkeys(self.columns["part"].tolist())
        return {name: self.columns["part"] == name for name in names}

    def kinds(self) -> dict[str, np.ndarray]:
        """Mask the frames of ALL, and of each kind of p and strength of the expression."""
        columns = self.columns
        rows = {ALL: np.ones(len(self.motion), dtype=bool)}
        rows |= {name: columns["kind"] == name for name in KINDS}
        rows |= {UNSCALED: columns["unscaled"], VARYING: columns["varies"]}
        rows |= {name: columns["strength"] == name for name in STRENGTHS}
        return {name: mask for name, mask in rows.items() if mask.any()}

    def scores(
        self,
        groups: Mapping[str, np.ndarray],
        costs: Mapping[str, Cost] = MappingProxyType({}),
    ) -> list[Score]:
        """Score each contender on each group of frames; groups in which nothing moves are left out.

        costs: of binds by name, where a method needs a head or the simulator; without one it has no cost. Raises
        InputError where simulation moves no frame of ALL.
        """
        scores = []
        for number, contender in enumerate(self.contenders):
            cost = self._cost(number, costs)
            for name, rows in groups.items():
                faces = len(np.unique(self.columns["trial"][rows]))
                score = score_distances(
                    contender, name, self.errors[number][rows], self.motion[rows], cost, faces=faces
                )
                if score.vertices:
                    scores.append(score)
                elif name == ALL:
                    raise InputError("evaluate: simulation moves no frame of these faces beyond their bones")
        return scores

    def _cost(self, number: int, costs: Mapping[str, Cost]) -> Cost:
        bind, frame = (1e3 * float(np.median(s)) if s else None for s in (self.binds[number], self.frames[number]))
        contender = self.contenders[number]
        if contender.needs == "nothing":
            return Cost(bind_ms=bind, frame_ms=frame)
        return replace(costs.get(contender.name, Cost()), frame_ms=frame)


def measure_bind(method: Method, faces: Sequence[KeptFace]) -> Cost:
    """Measure what a user waits for before the first frame: the medians over some faces, after one that is not counted.

    A head is fitted, and the simulator runs, where the method needs them. InputError where nobody fits heads.
    """
    rows = []
    for face in (kept.without_kept() for kept in (faces[0], *faces)):
        begin = time.process_time()
        if method.needs != "nothing":
            _ = face.live
        fitted = time.process_time()
        method.bind(face)
        rows.append((fitted - begin, time.process_time() - fitted))
    head, bind = 1e3 * np.median(rows[1:], axis=0)
    return Cost(head_ms=float(head), bind_ms=float(bind))


def measure_frames(contenders: Sequence[Contender], trials: Iterable[Trial]) -> Distances:
    """Have each contender answer each trial; trials without frames are left out. InputError where there is no frame."""
    motion: list[Floats32] = []
    columns: dict[str, list] = {name: [] for name in ("trial", "part", "kind", "strength", "varies", "unscaled")}
    errors: list[list[Floats32]] = [[] for _ in contenders]
    binds: list[list[float]] = [[] for _ in contenders]
    frames: list[list[float]] = [[] for _ in contenders]
    for number, trial in enumerate(trials):
        count = len(trial.weights)
        if not count:
            continue
        carried = trial.face.carried
        motion.append(np.linalg.norm(trial.truth - carried, axis=2))
        columns["strength"] += [strength_of(w) for w in trial.weights]
        of_face = {
            "trial": number,
            "part": trial.part,
            "kind": kind_of_coefficients(trial.face.coefficients),
            "varies": bool(trial.face.coefficients[:, 1:].any()),
            "unscaled": not carried.any(),
        }
        for name, value in of_face.items():
            columns[name] += [value] * count
        for k, contender in enumerate(contenders):
            answers = contender.answer(trial)
            errors[k].append(np.linalg.norm(answers.corrected - trial.truth, axis=2).astype(np.float32))
            binds[k] += [] if answers.bind_seconds is None else [answers.bind_seconds]
            frames[k] += answers.frame_seconds
    if not motion:
        raise InputError(
            "evaluate: the faces have no accepted static frames; make more of the corpus, or another split"
        )
    arrays = {name: np.array(values) for name, values in columns.items()}
    distances = [np.concatenate(rows) for rows in errors]
    return Distances(contenders, arrays, np.concatenate(motion), distances, binds, frames)


def score_distances(
    contender: Contender, kind: str, error: Floats, motion: Floats, cost: Cost | None = None, *, faces: int = 1
) -> Score:
    """Score distances to T against |T - carried(S)|; both [mm], shape (frames, n).

    Raises InputError where there is no frame, and for numbers that are not finite.
    """
    if not len(error) or not (np.isfinite(error).all() and np.isfinite(motion).all()):
        why = "numbers that are not finite" if len(error) else "no frame"
        raise InputError(f"evaluate: {contender.name}, {kind}: {why}")
    return Score(
        method=contender.name,
        kind=kind,
        frames=len(error),
        faces=faces,
        everywhere=float(error.mean()),
        simulates=contender.needs == "simulator",
        **asdict(measure(error, motion)),
        **asdict(Cost() if cost is None else cost),
    )


def evaluate(
    methods: Sequence[Method],
    trials: Iterable[Trial],
    costs: Mapping[str, Cost] = MappingProxyType({}),
) -> list[Score]:
    """Score methods that are ready over all static frames of trials (ALL), and by kind of p and expression's strength.

    Raises what `measure_frames` and `Distances.scores` raise.
    """
    table = measure_frames([*map(by_frame, methods)], trials)
    return table.scores(table.kinds(), costs)
