"""How far a face is from converged finite elements, by the cells that share a deformation and by the mesh."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from ....animation.pictures import Panel, draw_strip
from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.limits import SEED, STUDIED_PEOPLE
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.expressions import parse_weights
from ....lhm.head.head import LayeredHead
from ....lhm.template.template import LEVELS
from ....reference import Face, Parameters, Solution, solve
from ....reference.face.settle import SettledFace, carry_by_bones, carry_skin, neutral_scene, settle
from ....reference.face.tissue import CellKind
from ....surrogate.corpus.mixture import draw
from ....surrogate.ruler import MOVES, measure
from ...harness.first_screen import PRISMS, TETS, mean_share, tell_distance
from ...harness.study import Column, Row, Table, Task, Values, above, at_most
from ..measures import count_work, distances, load_kernels
from ..person import OfPerson, Person, check_known
from .refine import carry, refine_scene

EFFECTS: Mapping[str, Parameters] = {
    "volume -20 %": Parameters(soft_volume=0.8),
    "volume +40 %": Parameters(soft_volume=1.4),
    "3 g, 2 kPa": Parameters(gravity=3.0, soft_stiffness=2.0),
    "skin +15 %": Parameters(skin_growth=1.15),
    "muscle +25 %": Parameters(muscle_volume=1.25),
    "jaw 12 % longer": Parameters(mandible_scale_y=1.12),
}
EXPRESSIONS = (
    "jawOpen*0.7+mouthSmileLeft*0.4+mouthSmileRight*0.4",
    "cheekPuff*0.8+mouthPucker*0.5",
    "mouthSmileLeft*0.8+mouthSmileRight*0.8+browDownLeft*0.6",
    "jawOpen*0.6+mouthFunnel*0.5",
    "mouthFrownLeft*0.7+mouthFrownRight*0.7+browInnerUp*0.8",
)
"""Each is one person's, under random materials and effects."""
RANDOM = 700
"""Seed of the first expression's parameters."""
DRAWN = "volume +40 %", "3 g, 2 kPa"
"""Effects that are drawn on the first person."""
COARSE = 1
"""Level of the head on which quadratic tets are refined."""
ORDERS = 0.5, 3.0
"""Bounds of the order of quadratic tets by which they are extrapolated; the highest is that of a smooth answer."""
REFINED = ", refined"
"""End of the method of rows that refine quadratic tets."""


@dataclass(frozen=True)
class Discretisation:
    """Cells of a head of so many levels above the study's, sub-layers of its tissues, and how a scene is solved."""

    cells: CellKind = "prisms"
    finer: int = 0
    layers: tuple[int, int] = (1, 1)
    how: Mapping[str, Any] = field(
        default_factory=lambda: {"solver": "projective", "tolerance": 1e-7, "max_iterations": 3000}
    )


TRUTH = "FEniCSx, quadratic tets"
METHODS: Mapping[str, Discretisation] = {
    TETS: Discretisation("tets"),
    PRISMS: Discretisation(),
    "PD, prisms, coarser head": Discretisation(finer=-1),
    "PD, prisms, finer head": Discretisation(finer=1),
    "PD, prisms, two sub-layers": Discretisation(layers=(2, 2)),
    "FEniCSx, prisms": Discretisation(how={"solver": "fenicsx", "tolerance": 1e-6}),
}
QUADRATIC = Discretisation("tets", how={"solver": "fenicsx", "element": "P2", "tolerance": 1e-6})


@dataclass(frozen=True, eq=False)
class Answer:
    """A face's skin [mm]; the neutral face and the expression that were solved for it; tets and processor time [s]."""

    skin: Floats
    settled: SettledFace
    expressed: Solution | None
    tets: int
    seconds: float

    @property
    def solutions(self) -> Sequence[Solution]:
        """The one or two solves that it took."""
        return [each for each in (self.settled.solution, self.expressed) if each is not None]

    def describe(self, what: str) -> dict[str, Any]:
        """Give the line of a mesh; the work is that of the last solve."""
        work = count_work(self.solutions[-1]) | {"converged": all(each.converged for each in self.solutions)}
        return {"what": what, "tets": self.tets, "seconds": self.seconds, **work}


@dataclass(frozen=True)
class MeshError(OfPerson):
    """Effects that settle the neutral face of some people, and expressions, by several meshes and quadratic tets."""

    name = "mesh"
    version = 2
    heading = "How far is the simulator from converged finite elements?"
    question = "Which share of a face's motion do tets and prisms miss, of which size, and how exact is the truth?"
    needs = ("people", "heads")
    columns = (
        Column("what", "mesh"),
        Column("tets", "tets"),
        Column("share", "missed, of the motion"),
        Column("mean", "distance, mean [mm]"),
        Column("p95", "95 % [mm]"),
        Column("largest", "max [mm]"),
        Column("moved", "moved, mean [mm]"),
        Column("seconds", "processor time [s]", cost=True),
        Column("iterations", "iterations", cost=True),
    )
    note = (
        "Distances of the face's skin to quadratic tets on the study's head, over the vertices that move by more than "
        "0.05 mm beyond scaled bones, with prescribed bones. Effects settle the neutral face. Each expression is one "
        "person's, under random materials and effects, and its neutral face settles first. Seconds count scene, "
        "preparation and solve of both; quadratic tets start at PD's prisms, whose seconds are counted. Coarser and "
        "finer heads have other wraps, whose difference is part of their error. Refined: linear and quadratic tets on "
        f"a head of level {COARSE}, and on its tets split into eight, as long as those of the truth. The order of "
        "quadratic tets is the one by which both elements' steps are extrapolated to the same limit, by least "
        "squares; `left` is the finer quadratic answer's distance to it."
    )
    limit = 7200.0
    bounds: ClassVar[Mapping[str, float]] = {"effects": 0.12, "expressions": 0.1, "truth": 0.05, "tets": 1.0}
    """Bounds of the prisms' mean error, and of the truth's own, of the motion; and of tets' error over prisms'."""

    people: int = option(1, "how many people's neutral faces settle", bound=STUDIED_PEOPLE)
    seed: int = option(900, "seed of the first person", bound=SEED)
    effects: tuple[str, ...] = option(tuple(EFFECTS), f"one of {', '.join(EFFECTS)}; repeat for several")
    expressions: tuple[str, ...] = option(EXPRESSIONS, "as jawOpen*0.5+cheekPuff; repeat for several")
    refined: tuple[str, ...] = option(DRAWN, "an effect by refined quadratic tets; repeat for several")
    methods: tuple[str, ...] = option(tuple(METHODS), f"one of {', '.join(METHODS)}; repeat for several")

    def tasks(self) -> Sequence[Task]:
        """List effects of people, expressions, and what is refined. Raises InputError for options out of range."""
        self.check(self.expressions)
        check_known("effect", (*self.effects, *self.refined), EFFECTS)
        check_known("method", self.methods, METHODS)
        if self.people < 1:
            raise InputError(f"people: must be at least 1, got {self.people}")
        settling = [Task(name, f"seed {self.seed + k}") for k in range(self.people) for name in self.effects]
        moving = [Task(text, f"seed {self.seed + k}") for k, text in enumerate(self.expressions)]
        return settling + moving + [Task(name, f"seed {self.seed}{REFINED}") for name in self.refined]

    def measure(self, task: Task) -> Values:
        """Solve one case by its meshes; each is one of `rows`."""
        _load_solvers()
        seed = int(task.method.removesuffix(REFINED).split()[1])
        if task.method.endswith(REFINED):
            return _refine(self.person(COARSE, seed), EFFECTS[task.case])
        person = self.person(seed=seed)
        weights = None if task.case in EFFECTS else parse_weights(task.case)
        p = _draw_parameters(person, seed - self.seed) if weights is not None else EFFECTS[task.case]
        answers = {PRISMS: find_answer(person, p, weights, METHODS[PRISMS])}
        truth = find_answer(person, p, weights, QUADRATIC, answers[PRISMS])
        for name in self.methods:
            level = self.level + METHODS[name].finer
            if name not in answers and level in LEVELS:
                answers[name] = find_answer(self.person(level, seed), p, weights, METHODS[name])
        rest = person.head.skin.vertices if weights is None else person.blend(weights)
        moved = truth.skin - rest - person.face(p).carried
        answers[TRUTH] = truth
        rows = [
            answers[name].describe(name) | _compare(answers[name].skin, truth.skin, moved, person.head)
            for name in (*METHODS, TRUTH)
            if name in answers
        ]
        pictures = {}
        if task.case in DRAWN and seed == self.seed and TETS in answers:
            shown = {f"{row['what']}: misses {100 * row['share']:.0f} %": answers[row["what"]].skin for row in rows[:2]}
            caption = f"{task.case}: how far tets and prisms are off, and how far quadratic tets move"
            pictures[caption] = draw_errors(person.head, shown, truth.skin, moved)
        return {"kind": "expressions" if weights is not None else "effects", "rows": rows, **pictures}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that prisms are near converged elements and nearer than tets, and that the truth is one."""
        lines = [line for row in rows for line in row.values["rows"]]
        if not lines:
            return []
        unfinished = sum(not line["converged"] for line in lines)
        gates = [at_most("solves that did not reach what was asked", unfinished, 0)]
        what = "share of the motion that prisms miss, mean over"
        for kind in ("effects", "expressions"):
            tets, prisms = (mean_share(rows, name, kind) for name in (TETS, PRISMS))
            if prisms is not None:
                gates.append(at_most(f"{what} {kind}", prisms, self.bounds[kind]))
            if tets is not None and prisms:
                gates.append(above(f"what tets miss over what prisms miss, {kind}", tets / prisms, self.bounds["tets"]))
        left = [row.values["left"] for row in rows if "left" in row.values]
        if left:
            gates.append(
                at_most("share of the motion that refined quadratic tets still miss", max(left), self.bounds["truth"])
            )
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what tets and prisms miss, and how exact the truth is."""
        sentences = [tell_distance(rows)]
        for row in rows:
            if "left" in row.values:
                sentences.append(
                    f"{row.case}: refined once, quadratic tets on level {COARSE} change by "
                    f"{100 * row.values['step']:.1f} % of the motion; {100 * row.values['left']:.1f} % are left by "
                    f"their order {row.values['order']:.1f}."
                )
        return " ".join(text for text in sentences if text)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate each mesh's mean share by effect and over expressions, with its time."""
        compared = [row for row in rows if "kind" in row.values]
        cases = dict.fromkeys(row.case for row in compared if row.case in EFFECTS)
        lines = []
        for name in (*METHODS, TRUTH):
            own = [line for row in compared for line in row.values["rows"] if line["what"] == name]
            if own:
                shares = [mean_share(compared, name, kind) for kind in (*cases, "effects", "expressions")]
                percent = ["" if share is None else f"{100 * share:.1f} %" for share in shares]
                seconds = float(np.median([line["seconds"] for line in own]))
                lines.append((name, int(np.median([line["tets"] for line in own])), *percent, seconds))
        titles = ["mesh", "tets", *cases, "effects, mean", "expressions, mean", "processor time, median [s]"]
        refined = [(row.case, *(row.values[key] for key in ("step", "order", "left")))
                   for row in rows if "left" in row.values]  # fmt: skip
        head = ["effect", "step of quadratic tets, of the motion", "order", "left, of the motion"]
        tables = [
            Table("Share of the motion that a mesh misses", titles, lines),
            Table(f"The truth refined, level {COARSE}", head, refined),
        ]
        return [table for table in tables if table.rows]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw what each mesh misses against its time."""
        compared = [row for row in rows if "kind" in row.values]
        figure, axis = subplots(figsize=(6.4, 3.8))
        for name in METHODS:
            own = [line for row in compared for line in row.values["rows"] if line["what"] == name]
            if own:
                seconds, shares = (np.array([line[key] for line in own]) for key in ("seconds", "share"))
                (dots,) = axis.plot(seconds, 100 * shares, ".", alpha=0.35)
                axis.plot(np.median(seconds), 100 * shares.mean(), "o", color=dots.get_color(), ms=8, label=name)
        if not axis.lines:
            return {}
        axis.set(xscale="log", ylim=(0.0, None), xlabel="processor time [s]", ylabel="missed, of the motion [%]")
        axis.legend(fontsize=8)
        return {"What a mesh misses against its time; large: mean and median.": to_svg(figure)}


def find_answer(
    person: Person, p: Parameters, weights: Floats | None, mesh: Discretisation, near: Answer | None = None
) -> Answer:
    """Settle a neutral face by a mesh, from that of another answer; with weights (52,), solve their expression on it.

    The time includes that of the answer where it starts.
    """
    shapes = person.shapes if weights is not None else np.zeros((0, 0, 3))
    begin = time.process_time()
    choices: dict[str, Any] = {"bones": "prescribed", "cells": mesh.cells, "layers": mesh.layers}
    start = None if near is None else near.settled.positions
    settled = settle(person.head, p, start=start, **mesh.how, **choices)
    skin, expressed, tets = settled.skin, None, 0 if settled.solution is None else len(settled.solution.volume_ratio)
    if weights is not None:
        face = Face(person.head, shapes, p, per="wraps", choices=choices).settled_as(settled)
        scene = face.scene(weights)
        start = None if near is None or near.expressed is None else near.expressed.positions
        expressed, tets = solve(scene, start=start, **mesh.how), len(scene.tets)
        skin = face.skin_after(weights, expressed.positions)
    seconds = time.process_time() - begin + (0.0 if near is None else near.seconds)
    return Answer(skin, settled, expressed, tets, seconds)


@lru_cache(maxsize=1)
def _load_solvers() -> None:
    """Do once per process what is in no answer's time."""
    load_kernels()
    for element in ("P1", "P2"):
        load_kernels(solver="fenicsx", element=element)


def _draw_parameters(person: Person, number: int) -> Parameters:
    drawn = draw(np.random.default_rng(RANDOM + number), "both", field=False)
    return drawn.parameters(person.head, person.space.mean)


def _compare(skin: Floats, truth: Floats, moved: Floats, head: LayeredHead) -> dict[str, Any]:
    """Measure the face's distances to the truth (n, 3) [mm], and their share of how it has `moved` (n, 3)."""
    face = _find_face(head)
    return asdict(measure(distances(skin, truth)[face], np.linalg.norm(moved, axis=1)[face]))


def _find_face(head: LayeredHead) -> np.ndarray:
    """Find the skin's vertices (n,) of the face; all of a head without that region."""
    return head.on_skin(["face"]) if "face" in head.regions else np.ones(len(head.skin.vertices), dtype=bool)


def _refine(person: Person, p: Parameters) -> Values:
    """Solve an effect by linear and quadratic tets, on a head's tets and on each split into eight."""
    head, count = person.head, len(person.head.bone)
    coarse = neutral_scene(head, p, cells="tets")
    finer, ends = refine_scene(coarse)
    start = carry_by_bones(head, p)
    solved: dict[str, tuple[Solution, float]] = {}
    for end, scene in {"": coarse, REFINED: finer}.items():
        for element, mesh in {"linear tets": METHODS[TETS], "quadratic tets": QUADRATIC}.items():
            begin = time.process_time()
            solution = solve(scene, start=start, **mesh.how)
            solved[element + end] = solution, time.process_time() - begin
            start = solution.positions
        start = carry(solved["linear tets"][0].positions, ends)
    skins = {
        name: head.skin.vertices + head.skin_from_wrap @ (solution.positions[:count] - head.skin_wrap.vertices)
        for name, (solution, _) in solved.items()
    }
    finest = skins[f"quadratic tets{REFINED}"]
    moved = finest - head.skin.vertices - carry_skin(head, p)
    rows = []
    for name, (solution, seconds) in solved.items():
        line = {"what": name, "tets": len(solution.volume_ratio), "seconds": seconds, **count_work(solution)}
        rows.append(line | _compare(skins[name], finest, moved, head))
    counts = _find_face(head) & (np.linalg.norm(moved, axis=1) > MOVES)
    linear, quadratic, finer_linear, finer_quadratic = (skin[counts].ravel() for skin in skins.values())
    steps = np.stack([finer_linear - linear, quadratic - finer_quadratic], axis=1)
    # Both elements have one limit: P1' + a (P1' - P1) = P2' + b (P2' - P2), where b is 1 / (2^order - 1).
    share = np.linalg.lstsq(steps, finer_quadratic - finer_linear, rcond=None)[0][1]
    used = float(np.clip(share, *(1.0 / (2.0**order - 1.0) for order in reversed(ORDERS))))
    step = rows[1]["share"]
    return {"rows": rows, "step": step, "order": float(np.log2(1.0 + 1.0 / used)), "left": step * used}


def draw_errors(head: LayeredHead, skins: Mapping[str, Floats], truth: Floats, moved: Floats) -> bytes:
    """Draw how far skins (n, 3) are from the truth, by caption, and how far that has `moved` (n, 3) [mm]: PNG."""
    face = _find_face(head)
    errors = {caption: distances(skin, truth) for caption, skin in skins.items()}
    top = max(float(np.percentile(error[face], 99)) for error in errors.values())
    panels = [Panel(caption, head.skin.with_vertices(skins[caption]), error, top) for caption, error in errors.items()]
    motion = np.linalg.norm(moved, axis=1)
    surface = head.skin.with_vertices(truth)
    panels.append(Panel(f"{TRUTH}: its motion", surface, motion, float(np.percentile(motion[face], 99))))
    return draw_strip(panels, framed=head.skin.vertices[face])
