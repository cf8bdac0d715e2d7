"""One contest: cases x methods x measures -> rows in long form, of which every comparison of faces is a question.

A `Case` makes a face under p, and has weights of its frames. `run_contest` has each method move a fresh face, so that
it pays for all that it asks, and measures its skins to those of the truths, which are methods, too. Error and seconds
of a row are of the same frame. `summarise` groups rows.

    rows = run_contest(case, [m.NETWORK, m.SETTLED], truths=[m.PD])
    summarise(rows, "method", truth=m.PD)[m.NETWORK].share

A row is JSON: case, kind, method, cells (of the face that the method moved), frame, status ("done", "skipped",
"failed"), reason, four times in seconds of processor time, `told` (what the method said of the frame: iterations,
reason, inverted; the dial its error) and `to` (by truth, what `compare_skins` gives). The times: `head_s` fits the head
where the method needs one; `bind_s` is all that face and p need before the first frame; `frame_s` is one frame;
`compile_s` is an uncounted run of another case before, in which a process compiles and loads what it does once. A time
or distance that was not measured is None.

A study is a subclass of `Contest`: it lists names of cases, and makes each with its methods and truths; then gates,
words and tables group `collect_rows(rows)`. A task is one case with all its methods, so that each truth is solved once.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.expressions import sample_weights
from ..lhm.template.template import DEFAULT_LEVEL
from ..reference import Face, Parameters
from ..surrogate import Surrogate
from ..surrogate import methods as m
from ..surrogate.corpus.mixture import STATIC, draw
from ..surrogate.corpus.people import People, people_from_text
from ..surrogate.methods import Method, SolvedRig, get_cells, on_cells
from ..surrogate.ruler import DEFAULT, MOVES, kind_of, measure
from .harness.study import Column, Row, Study, Task, Values, describe_failure

EVERY = "every method"
"""The method of a task in which all methods of a case run."""
COARSE = 1
"""Level of the head of the uncounted case."""


@dataclass(frozen=True, eq=False)
class Case:
    """A face, live or of a corpus, to make anew for every method, and weights (frames, 52).

    kind: by which rows are grouped. head_s: processor time [s] that its head took to fit, if it was measured.
    about: what else rows say of the case.
    """

    name: str
    kind: str
    make: Callable[[], Any]
    weights: Floats | Floats32
    head_s: float | None = None
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Made:
    """A method's frame: skin (n, 3) [mm]; of solvers also the scene's vertices [mm] and the rig that solved it."""

    skin: Floats
    positions: Floats | None = None
    rig: Any = None


Compare = Callable[[Face, Floats, Made, Made], Mapping[str, Any]]
"""Measures a face's frame of some weights (52,) beside that of a truth."""


def run_contest(
    case: Case,
    methods: Sequence[str | Method],
    truths: Sequence[str | Method],
    *,
    compare: Compare | None = None,
    warm: Case | None = None,
    on_frame: Callable[[str, Made], None] | None = None,
) -> list[dict[str, Any]]:
    """Run methods and truths on a case: a row for each method and frame; a failure is a row with its reason.

    compare: by default `compare_skins`. warm: the case that each method runs once in this process before it is timed.
    on_frame: sees each frame with its method's name.
    """
    known = {method.name: method for method in map(_find_method, (*truths, *methods))}
    made: dict[str, list[Made | None]] = {}
    rows: dict[str, list[dict[str, Any]]] = {}
    for name, method in known.items():
        compiled = None if warm is None else _warm_up(method, warm)
        made[name], rows[name] = _run(case, method)
        for row in rows[name]:
            row["compile_s"] = compiled
        for frame in made[name]:
            if frame is not None and on_frame is not None:
                on_frame(name, frame)
    face, measure_them = case.make(), compare_skins if compare is None else compare
    for truth in map(_find_method, truths):
        for name in known:
            for row, own, true in zip(rows[name], made[name], made[truth.name], strict=True):
                if own is not None and true is not None and name != truth.name:
                    row["to"][truth.name] = dict(measure_them(face, case.weights[row["frame"]], own, true))
    return [row for method in rows.values() for row in method]


def _find_method(method: str | Method) -> Method:
    return m.METHODS[method] if isinstance(method, str) else method


def _run(case: Case, method: Method) -> tuple[list[Made | None], list[dict[str, Any]]]:
    """Bind a fresh face, and make each frame."""
    face = on_cells(case.make(), method.cells)
    about = {"case": case.name, "kind": case.kind, "method": method.name, "cells": get_cells(face), **case.about}
    about |= {"head_s": 0.0 if method.needs == "nothing" else case.head_s, "bind_s": None}
    made: list[Made | None] = []
    rows: list[dict[str, Any]] = []
    rig, status, reason, begin = None, "done", "", time.process_time()
    try:
        rig = method.bind(face)
        about["bind_s"] = time.process_time() - begin
    except Exception as error:
        status, reason = describe_failure(error)
    for number, weights in enumerate(case.weights):
        row = {**about, "frame": number, "status": status, "reason": reason, "frame_s": None, "told": {}, "to": {}}
        rows.append(row)
        made.append(None)
        if rig is None:
            continue
        try:
            begin = time.process_time()
            skin = np.array(rig.frame(weights), dtype=np.float64)
            row["frame_s"] = time.process_time() - begin
        except Exception as error:
            row["status"], row["reason"] = describe_failure(error)
            continue
        last = rig.last if isinstance(rig, SolvedRig) else None
        if last is not None:
            row["told"] = dict(last.told)
        made[-1] = Made(skin, None if last is None else last.positions, rig)
    return made, rows


_warmed: dict[tuple[str, str], float] = {}
"""Processor time [s] of a method's uncounted run in this process, by method and case."""


def _warm_up(method: Method, warm: Case) -> float:
    key = method.name, warm.name
    if key not in _warmed:
        begin = time.process_time()
        _run(warm, method)
        _warmed[key] = time.process_time() - begin
    return _warmed[key]


def compare_skins(
    face: Face, weights: Floats, own: Made, true: Made, *, inside: np.ndarray | None = None, whole: bool = False
) -> dict[str, Any]:
    """Measure a skin's distances [mm] to a true one, where that moves beyond scaled bones and everywhere.

    inside: a mask (n,) of the vertices that count; None is all. whole: give `errors`, those of each moving vertex, too.

    mean, p95, largest, moved, share, vertices: see `surrogate.ruler`; None where nothing moves. everywhere, farthest:
    mean and largest distance over all vertices.
    """
    counted = slice(None) if inside is None else inside
    error = np.linalg.norm(own.skin - true.skin, axis=1)[counted]
    motion = np.linalg.norm(true.skin - face.blend(weights) - face.carried, axis=1)[counted]
    figures: dict[str, Any] = asdict(measure(error, motion))
    figures = {key: value if np.isfinite(value) else None for key, value in figures.items()}
    figures |= {"errors": error[motion > MOVES].astype(np.float32)} if whole else {}
    return figures | {"everywhere": float(error.mean()), "farthest": float(error.max())}


@dataclass(frozen=True)
class Summary:
    """Rows of one group that are done and, with a truth, have distances to it; `frames` are (case, frame) of them all.

    mean, largest [mm]: of errors over vertices that move, by `moved` on average. everywhere, farthest [mm]: over all.
    Times [s] are medians over the same frames, NaN where one of these has none: head, bind and frame.
    """

    frames: frozenset[tuple[str, int]]
    mean: float
    moved: float
    largest: float
    everywhere: float
    farthest: float
    head: float
    bind: float
    frame: float

    @property
    def share(self) -> float:
        """All errors over all motion."""
        return self.mean / self.moved

    @property
    def first(self) -> float:
        """Seconds to the first frame of a new face."""
        return self.head + self.bind + self.frame


def summarise(rows: Iterable[Mapping], by: str, truth: str = "") -> dict[Any, Summary]:
    """Group the rows by a key that are done and, with a `truth`, have distances to it."""
    groups: dict[Any, list[Mapping]] = {}
    for row in rows:
        if row["status"] == "done" and (not truth or truth in row["to"]):
            groups.setdefault(row[by], []).append(row)
    return {key: _summarise(group, truth) for key, group in groups.items()}


def _summarise(rows: Sequence[Mapping], truth: str) -> Summary:
    to = [row["to"][truth] for row in rows] if truth else []
    moving = [each for each in to if each["vertices"]]
    vertices = [each["vertices"] for each in moving]
    mean, moved = (
        float(np.average([each[key] for each in moving], weights=vertices)) if moving else np.nan
        for key in ("mean", "moved")
    )
    return Summary(
        frames=frozenset((row["case"], row["frame"]) for row in rows),
        mean=mean,
        moved=moved,
        largest=max((each["largest"] for each in moving), default=np.nan),
        everywhere=float(np.mean([each["everywhere"] for each in to])) if to else np.nan,
        farthest=max((each["farthest"] for each in to), default=np.nan),
        **{key: _middle(rows, f"{key}_s") for key in ("head", "bind", "frame")},
    )


def _middle(rows: Sequence[Mapping], key: str) -> float:
    """The median of what rows measured; NaN where one did not."""
    values = [row[key] for row in rows]
    return np.nan if None in values else float(np.median(values))


def collect_rows(rows: Iterable[Row]) -> list[Mapping]:
    """Collect the long rows of a study's tasks."""
    return [line for row in rows if row.done for line in row.values["rows"]]


def list_failures(rows: Iterable[Mapping]) -> list[str]:
    """Say which methods failed on which frames, and why."""
    return [f"{r['case']}, frame {r['frame']}, {r['method']}: {r['reason']}" for r in rows if r["status"] == "failed"]


def list_columns(truths: Iterable[str], distances: Iterable[str] = ("share", "mean")) -> tuple[Column, ...]:
    """List the columns of a contest's report: some distances to each truth, and costs."""
    return (
        *(Column(key, key) for key in ("kind", "method", "cells", "frame", "status")),
        *(Column(f"{truth}: {key}", f"to {truth}: {key}") for truth in truths for key in distances),
        *(Column(f"{key}_s", f"{key} [s]", cost=True) for key in ("head", "bind", "frame", "compile")),
        Column("iterations", "iterations", cost=True),
    )


class Contest(Study):
    """A study that is a list of cases with methods and truths; a subclass is a frozen dataclass of its options."""

    note = (
        "Every method moves a fresh face, and pays for all that it asks: head, bind, frame. It has run another case in "
        "the same process before, which is not counted. Seconds are processor time; cases may run side by side."
    )

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give a line for each row, with its distances by truth and what was told beside it."""
        return [
            row
            | row["told"]
            | {f"{truth}: {key}": value for truth, to in row["to"].items() for key, value in to.items()}
            for row in values["rows"]
        ]

    @abstractmethod
    def list_cases(self) -> Sequence[str]:
        """Name the cases. Raises InputError for options out of range."""

    @abstractmethod
    def make_case(self, name: str) -> Case:
        """Make a case by its name."""

    @abstractmethod
    def list_methods(self, name: str) -> Sequence[str | Method]:
        """List what runs on a case, beside the truths."""

    @abstractmethod
    def list_truths(self, name: str) -> Sequence[str | Method]:
        """List the methods to whose skins all others are compared."""

    def compare(self, face: Face, weights: Floats, own: Made, true: Made) -> Mapping[str, Any]:
        """Measure a frame beside a truth's; see `compare_skins`."""
        return compare_skins(face, weights, own, true)

    def warm(self) -> Case | None:
        """Make the case of the uncounted run."""
        return draw_case("uncounted", "anny", (1, 0), DEFAULT, 1, level=COARSE)

    def tasks(self) -> Sequence[Task]:
        """List a task for each case."""
        return [Task(name, EVERY) for name in self.list_cases()]

    def measure(self, task: Task) -> Values:
        """Run all methods on a case."""
        case, name = self.make_case(task.case), task.case
        methods, truths = self.list_methods(name), self.list_truths(name)
        return {"rows": run_contest(case, methods, truths, compare=self.compare, warm=self.warm())}


KINDS = ("materials", "single", "both", "default", "effects", "single")
"""Kinds of p of `draw_case`, as corpora draw them; "default" is no p at all."""
BEYOND = "beyond"
"""Kind of p that the shipped network has not seen: a muscle's softness, and a strain limit."""


@lru_cache(maxsize=8)
def draw_case(
    name: str,
    people: str,
    seed: tuple[int, ...],
    kind: str,
    frames: int,
    *,
    level: int = DEFAULT_LEVEL,
) -> Case:
    """Draw somebody of `people` (see `people_from_text`) by a seed, p of a kind (KINDS, or BEYOND), and expressions.

    Every second expression is hard: two to five shapes, up to full weight. The case's own kind is one of the ruler's.
    InputError for somebody whom the shipped network has learned from.
    """
    rng = np.random.default_rng(seed)
    people_there = find_people(people, level)
    who = people_there.person(rng)
    if Surrogate.load().has_learned_from(who.code):
        raise InputError(f"{name}: the shipped network has learned from the person of seed {seed}")
    begin = time.process_time()
    head = people_there.head(who)
    head_s = time.process_time() - begin
    names: tuple[str, ...] = ()
    if kind == BEYOND:
        far = {"muscle_strain_ratio": (0.05, 0.3), "strain_limit": (1.1, 1.2)}
        p = Parameters(**{key: float(rng.uniform(*span)) for key, span in far.items()})
    elif kind == DEFAULT:
        p = Parameters()
    elif kind in KINDS:
        drawn = draw(rng, kind, field=False)
        p, names = drawn.parameters(head, people_there.mean), tuple(set(drawn.names) & set(STATIC))
    else:
        raise InputError(f"kind {kind!r}: there are {', '.join(KINDS)} and {BEYOND}")
    weights = np.stack([draw_weights(rng, number) for number in range(frames)])

    def make() -> Face:
        return Face(head, who.shapes, p, per="wraps", code=who.code)

    return Case(name, BEYOND if kind == BEYOND else kind_of(names), make, weights, head_s)


@lru_cache(maxsize=4)
def find_people(text: str, level: int) -> People:
    """Return people by text, at a level of the template; read once per process."""
    return people_from_text(text, level=level)


def draw_weights(rng: np.random.Generator, number: int) -> Floats:
    """Draw an expression's weights (52,): of people who speak, or where the number is odd a hard one."""
    if number % 2 == 0:
        return sample_weights(rng)
    weights, count = np.zeros(52), rng.integers(2, 6)
    low, high = (0.2, 1.0) if rng.random() < 0.5 else (0.1, 0.5)
    weights[rng.choice(51, count, replace=False)] = rng.uniform(low, high, count)
    return weights
