"""Methods against the simulator: a table of frames x methods, and scores of its groups.

A `Trial` has frames of one face with their truth; a `Contender` answers it. `measure_frames` makes the table, and
`Distances.scores` groups it: by kind of p, strength of the expression, or the trials' own part.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from os import PathLike
from typing import Protocol

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.base.progress import OnProgress, silent
from .corpus.face import Face, Frames
from .corpus.plan import Split
from .corpus.reading import Faces, Row, Table
from .corpus.shard import FEM_LAWS
from .heads import BindCosts, Heads
from .methods import Method, Takes
from .ruler import KINDS, STRENGTHS, kind_of_coefficients, measure, strength_of

ALL, VARYING = "all", "p varying over the face"
UNSCALED = "no bone scaled"
SIMULATOR = "projective dynamics"
AGAINST = {law: f"against FEniCSx, {law}" for law in FEM_LAWS}
"""The part of frames whose truth is FEniCSx' answer by a law."""


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


@dataclass(frozen=True, eq=False)
class Trial:
    """Frames of one face to answer: weights (F, 52), their `truth` T - S (F, n, 3) [mm].

    carried (n, 3) [mm]: the part of T - S that scaled bones explain. part: a name that groups trials. sequence: the
    corpus' row where the frames follow one another. known: answers that are there already, by method.
    """

    face: Face
    weights: Floats32
    truth: Floats32
    carried: Floats32
    part: str = ALL
    sequence: Row | None = None
    known: Mapping[str, Floats32] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Answers:
    """T - S (F, n, 3) [mm] of a trial's frames, with processor seconds of the bind and of each frame, if measured."""

    corrected: Floats32
    bind_seconds: float | None = None
    frame_seconds: Sequence[float] = ()


class Named(Protocol):
    """What a score says of its method."""

    name: str
    simulates: bool


class Contender(ABC):
    """Whoever answers trials; `takes`: what a bind takes of the simulator."""

    def __init__(self, name: str, *, simulates: bool = False, takes: Takes = "nothing"):
        self.name, self.simulates, self.takes = name, simulates, takes

    @abstractmethod
    def answer(self, trial: Trial) -> Answers:
        """Answer all frames of a trial."""


class Static(Contender):
    """A method, fitted, that answers one frame at a time by its weights alone."""

    def __init__(self, method: Method):
        super().__init__(method.name, simulates=method.simulates, takes=method.takes)
        self._method = method

    def answer(self, trial: Trial) -> Answers:
        """Bind the face, and make each frame as a user has it: with S by blendshapes."""
        begin = time.process_time()
        rig = self._method.bind(trial.face)
        binding = time.process_time() - begin
        skin, shapes = trial.face.skin.astype(np.float32), np.asarray(trial.face.shapes, dtype=np.float32)
        corrected, seconds = [], []
        for row in trial.weights:
            begin = time.process_time()
            answer = rig.frame(row)
            seconds.append(time.process_time() - begin)
            corrected.append(answer - (skin + np.tensordot(row, shapes, axes=1)))
        return Answers(np.stack(corrected), binding, seconds)


class Known(Contender):
    """A method whose answers the trials have."""

    def answer(self, trial: Trial) -> Answers:
        """Hand out the trial's own answer of this name."""
        return Answers(trial.known[self.name])


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
        self, groups: Mapping[str, np.ndarray], costs: BindCosts | None = None, fits: Sequence[float | None] = ()
    ) -> list[Score]:
        """Score each contender on each group of frames; groups in which nothing moves are left out.

        costs: what binds take of the simulator; without it the bind of methods that take something has no cost. fits:
        seconds of each contender's learning. Raises InputError where simulation moves no frame of ALL.
        """
        scores = []
        for number, contender in enumerate(self.contenders):
            cost = self._cost(number, costs, fits[number] if fits else None)
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

    def _cost(self, number: int, costs: BindCosts | None, fitted: float | None) -> Cost:
        own, frame = (1e3 * float(np.median(s)) if s else None for s in (self.binds[number], self.frames[number]))
        takes = self.contenders[number].takes
        if takes == "nothing":
            return Cost(fitted, None, own, frame)
        if costs is None:
            return Cost(fitted, None, None, frame)
        # To carry the skin is what this bind does itself.
        bind = 1e3 * costs.seconds(takes) + (0.0 if takes == "carried" else own or 0.0)
        return Cost(fitted, 1e3 * costs.head, bind, frame)


def measure_frames(
    contenders: Sequence[Contender], trials: Iterable[Trial], on_progress: OnProgress = silent
) -> Distances:
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
        motion.append(np.linalg.norm(trial.truth - trial.carried, axis=2))
        columns["strength"] += [strength_of(w) for w in trial.weights]
        of_face = {
            "trial": number,
            "part": trial.part,
            "kind": kind_of_coefficients(trial.face.coefficients),
            "varies": bool(trial.face.coefficients[:, 1:].any()),
            "unscaled": not trial.carried.any(),
        }
        for name, value in of_face.items():
            columns[name] += [value] * count
        for k, contender in enumerate(contenders):
            answers = contender.answer(trial)
            errors[k].append(np.linalg.norm(answers.corrected - trial.truth, axis=2).astype(np.float32))
            binds[k] += [] if answers.bind_seconds is None else [answers.bind_seconds]
            frames[k] += answers.frame_seconds
        on_progress(f"evaluate: face {number + 1}", 0.0)
    if not motion:
        raise InputError(
            "evaluate: the faces have no accepted static frames; make more of the corpus, or another split"
        )
    arrays = {name: np.array(values) for name, values in columns.items()}
    distances = [np.concatenate(rows) for rows in errors]
    return Distances(contenders, arrays, np.concatenate(motion), distances, binds, frames)


def score_distances(
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


class Tests(Protocol):
    """Faces with static frames, such as `Faces`."""

    def __len__(self) -> int: ...

    def face(self, index: int) -> Face:
        """Read one of them."""
        ...

    def frames(self, index: int) -> Frames:
        """Read its frames, which may be none."""
        ...


def static_trials(test: Tests, heads: Heads, chosen: Sequence[int] | None = None) -> Iterator[Trial]:
    """Read the static frames of test faces, by default of all; InputError for scaled bones where nobody fits heads."""
    for index in range(len(test)) if chosen is None else chosen:
        frames = test.frames(index)
        if len(frames.weights):
            face = test.face(index)
            yield Trial(face, frames.weights, frames.corrected.astype(np.float32), heads.carry(face))


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

    heads: of the test people. training: faces that fit what is not fitted yet; None for methods that need none.
    chosen: numbers of test faces. Raises what `static_trials`, `measure_frames` and `Distances.scores` raise.
    """
    fits = []
    for number, method in enumerate(methods):
        begin = time.process_time()
        if training is not None:
            method.fit(training)
        fits.append(time.process_time() - begin)
        on_progress(f"fit: {method.name}", (number + 1) / len(methods))
    table = measure_frames([*map(Static, methods)], static_trials(test, heads, chosen), on_progress)
    return table.scores(table.kinds(), costs, fits)


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """A frame with an answer of FEniCSx: weights (52,), and T - S (n, 3) [mm] `simulated` by PD and of FEniCSx' `law`.

    face: the number of its face in the corpus.
    """

    law: str
    face: int
    weights: Floats32
    simulated: Floats32
    fenicsx: Floats32


def read_references(
    folder: str | PathLike[str], split: Split | None, faces: Faces, *, partial: bool = False
) -> Iterator[ReferenceFrame]:
    """Read the frames of `faces` that FEniCSx solved, too, one after another; raises what `Table` raises."""
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
            simulated, truth = (source["corrected"].astype(np.float32) for source in (static, row))
            yield ReferenceFrame(row["law"].decode(), face, static["weights"], simulated, truth)


def evaluate_references(
    methods: Sequence[Method],
    folder: str | PathLike[str],
    split: Split | None,
    heads: Heads,
    *,
    partial: bool = False,
    on_progress: OnProgress = silent,
) -> list[Score]:
    """Score projective dynamics and each method, which is fitted, by law that the corpus has: T is FEniCSx' answer.

    heads: of the corpus' people. Raises InputError where no frame with references has derivatives, and what `Table`
    raises.
    """
    faces = Faces(folder, split, partial=partial)
    grouped: dict[tuple[str, int], list[ReferenceFrame]] = {}
    for frame in read_references(folder, split, faces, partial=partial):
        grouped.setdefault((frame.law, frame.face), []).append(frame)
    if not grouped:
        raise InputError(f"corpus {folder}: no frame with an answer of FEniCSx has derivatives")

    def trials() -> Iterator[Trial]:
        for (law, index), frames in grouped.items():
            face = faces.face(index)
            weights, truth = np.stack([f.weights for f in frames]), np.stack([f.fenicsx for f in frames])
            known = {SIMULATOR: np.stack([frame.simulated for frame in frames])}
            yield Trial(face, weights, truth, heads.carry(face), AGAINST[law], known=known)

    table = measure_frames([Known(SIMULATOR, simulates=True), *map(Static, methods)], trials(), on_progress)
    return table.scores(table.parts())
