"""How far a face is from converged finite elements, by the cells that share a deformation and by the mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ....lhm.base.limits import SEED, STUDIED_PEOPLE
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.expressions import ARKIT, parse_weights
from ....lhm.head.flesh import cheek_share
from ....lhm.head.head import LayeredHead
from ....lhm.template.template import LEVELS
from ....reference import Face, Parameters
from ....reference.face.settle import carry_by_bones, carry_skin, neutral_scene
from ....surrogate import methods as m
from ....surrogate.corpus.mixture import draw
from ....surrogate.methods import METHODS, Method, Solved, SolvedRig, use_solver
from ....surrogate.ruler import measure
from ...contest import Case, Contest, Made, compare_skins
from ...harness.study import Column, Row, Table, Task, Values, above, at_most
from ..measures import distances, solve_to_end
from ..person import OfPerson, Person, check_known
from .face import extrapolate
from .refine import carry, keep_used, refine_scene

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
COARSE = 1
"""Level of the head whose cheek's quadratic tets are refined."""
REFINED = "quadratic tets, refined twice"
"""The method of rows that refine them."""
TRUTH = m.FENICSX_P2
COARSER, FINER, SUBLAYERS = "PD, coarser head", "PD, finer head", "PD, two sub-layers"
TOLERANCE, LOOSE = 1e-6, 1e-4
"""Gradient norm relative to that at the start, of refined solves, and of expressions by quadratic tets."""
MESHES = (m.PD_TETS, m.PD, COARSER, FINER, SUBLAYERS)
"""Meshes that are compared with the truth."""


@dataclass(frozen=True)
class MeshError(OfPerson, Contest):
    """Effects that settle the neutral face of some people, and expressions, by several meshes and quadratic tets."""

    name = "mesh"
    version = 3
    question = "How far is the simulator from converged finite elements?"
    needs = ("people", "heads")
    timed = False
    columns = (
        Column("method", "mesh"),
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
        "0.05 mm beyond scaled bones, with prescribed bones. The first person settles by every effect, each other one "
        "by one of them in turn. Each expression is one person's, under random materials and effects, and its neutral "
        "face settles first. Seconds count what settles and solves, once code is compiled; quadratic tets start at "
        f"PD's prisms, whose seconds are counted, and those of expressions end at {LOOSE:g} of the gradient there. "
        "Coarser and finer heads have other wraps, whose difference is part of their error. Refined: the left cheek of "
        f"a head of level {COARSE}, the rest of which is held, by quadratic "
        "tets on its mesh, and on that split into eight and into 64. The order is the one that the three answers show; "
        "`left` is the middle one's distance to their extrapolated limit: its elements have the size of the truth's."
    )
    limit = 7200.0
    bounds: ClassVar[Mapping[str, float]] = {"effects": 0.12, "expressions": 0.1, "truth": 0.05, "tets": 1.0}
    """Bounds of the prisms' mean error, and of the truth's own, of the motion; and of tets' error over prisms'."""

    people: int = option(1, "how many people's neutral faces settle", bound=STUDIED_PEOPLE)
    seed: int = option(900, "seed of the first person", bound=SEED)
    effects: tuple[str, ...] = option(tuple(EFFECTS), f"one of {', '.join(EFFECTS)}; repeat for several")
    expressions: tuple[str, ...] = option(EXPRESSIONS, "as jawOpen*0.5+cheekPuff; repeat for several")
    refined: tuple[str, ...] = option(
        ("volume +40 %", "3 g, 2 kPa"), "an effect by refined quadratic tets; repeat for several"
    )
    methods: tuple[str, ...] = option(MESHES, f"one of {', '.join(MESHES)}; repeat for several")

    def tasks(self) -> Sequence[Task]:
        """List effects of people, expressions, and what is refined. Raises InputError for options out of range."""
        self.check(self.expressions)
        check_known("effect", (*self.effects, *self.refined), EFFECTS)
        check_known("method", self.methods, MESHES)
        return [*super().tasks(), *(Task(name, REFINED) for name in self.refined)]

    def list_cases(self) -> Sequence[str]:
        """Name effects and expressions with the seed of whom they move."""
        return [*self._describe_cases()]

    def _describe_cases(self) -> dict[str, tuple[str, int]]:
        """Give an effect or expression, and the person's number, by case."""
        effects = [(name, 0) for name in self.effects]
        if self.effects:
            effects += [(self.effects[k % len(self.effects)], k) for k in range(1, self.people)]
        described = [*effects, *((text, k) for k, text in enumerate(self.expressions))]
        return {f"{text}, seed {self.seed + k}": (text, k) for text, k in described}

    def make_case(self, name: str) -> Case:
        """Make a face under an effect, without an expression, or an expression's under random materials and effects."""
        text, number = self._describe_cases()[name]
        person = self.person(seed=self.seed + number)
        if text in EFFECTS:
            kind, p, weights = "effects", EFFECTS[text], np.zeros(len(ARKIT))
        else:
            kind, p, weights = "expressions", _draw_parameters(person, number), parse_weights(text)
        return Case(name, kind, lambda: _make_face(person, p), weights[None], about={"what": text})

    def list_methods(self, name: str) -> Sequence[Method]:
        """List the meshes; see `MESHES`."""
        text, number = self._describe_cases()[name]
        levels = {COARSER: self.level - 1, FINER: self.level + 1}
        methods = []
        for mesh in self.methods:
            if mesh in METHODS:
                methods.append(METHODS[mesh])
            elif levels.get(mesh, self.level) in LEVELS:
                head = self.person(levels.get(mesh), self.seed + number).head
                methods.append(_on_mesh(mesh, head, (2, 2) if mesh == SUBLAYERS else (1, 1)))
        return [_at_rest(method) for method in methods] if text in EFFECTS else methods

    def list_truths(self, name: str) -> Sequence[Method]:
        """Give quadratic tets."""
        text, _ = self._describe_cases()[name]
        return [_at_rest(METHODS[TRUTH]) if text in EFFECTS else _loosen(METHODS[TRUTH])]

    def compare(self, face: Face, weights: Floats, own: Made, true: Made) -> Mapping[str, Any]:
        """Compare skins in the face."""
        return compare_skins(face, weights, own, true, inside=_find_face(face.head))

    def warm(self) -> Case | None:
        """Settle a coarse head first, which compiles."""
        person = self.person(min(LEVELS), self.seed)
        weights = np.zeros((1, len(ARKIT)))
        return Case("uncounted", "effects", lambda: _make_face(person, EFFECTS["volume -20 %"]), weights)

    def measure(self, task: Task) -> Values:
        """Solve one case by its meshes, each one of `rows`, or an effect on refined ones."""
        return _refine(self.person(COARSE, self.seed), task.case) if task.method == REFINED else super().measure(task)

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give the report's lines: rows with their distance to the truth and what they took."""
        lines = []
        for row in values["rows"]:
            seconds = None if row["frame_s"] is None else row["bind_s"] + row["frame_s"]
            told = {"iterations": row["told"].get("iterations"), "seconds": seconds}
            lines.append(row | row["to"].get(TRUTH, {}) | told)
        return lines

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that prisms are near converged elements and nearer than tets, and that the truth is one."""
        lines = [line for row in rows for line in row.values["rows"]]
        if not lines:
            return []
        unfinished = sum(line["status"] != "done" for line in lines)
        gates = [at_most("solves that did not reach what was asked", unfinished, 0)]
        what = "share of the motion that prisms miss, mean over"
        for kind in ("effects", "expressions"):
            tets, prisms = (mean_share(rows, name, kind) for name in (m.PD_TETS, m.PD))
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
                    f"{row.case}, on a cheek: quadratic tets of the truth's size are {100 * row.values['left']:.1f} % "
                    f"of the motion off the limit of three meshes, by their order {row.values['order']:.1f}."
                )
        return " ".join(text for text in sentences if text)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate each mesh's mean share by effect and over expressions, with its time."""
        compared = [row for row in rows if row.method != REFINED]
        lines = [line for row in compared for line in self.lines(row.values) if line["status"] == "done"]
        cases = dict.fromkeys(line["what"] for line in lines if line["kind"] == "effects")
        table = []
        for name in (*MESHES, TRUTH):
            if own := [line for line in lines if line["method"] == name]:
                shares = [mean_share(compared, name, kind) for kind in (*cases, "effects", "expressions")]
                percent = ["" if share is None else f"{100 * share:.1f} %" for share in shares]
                table.append((name, *percent, float(np.median([line["seconds"] for line in own]))))
        titles = ["mesh", *cases, "effects, mean", "expressions, mean", "processor time, median [s]"]
        keys = ("share", "order", "left", "tets")
        refined = [(row.case, *(row.values[key] for key in keys)) for row in rows if row.method == REFINED]
        head = ["effect", "middle mesh to the finest, of the motion", "order", "left, of the motion", "tets of all"]
        tables = [
            Table("Share of the motion that a mesh misses", titles, table),
            Table(f"The truth refined: the left cheek of a head of level {COARSE}", head, refined),
        ]
        return [table for table in tables if table.rows]


def _make_face(person: Person, p: Parameters) -> Face:
    return replace(person.face(p), choices={"bones": "prescribed"})


def _draw_parameters(person: Person, number: int) -> Parameters:
    drawn = draw(np.random.default_rng(RANDOM + number), "both", field=False)
    return drawn.parameters(person.head, person.space.mean)


def _on_mesh(name: str, head: LayeredHead, layers: tuple[int, int]) -> Method:
    """Make PD on another head of the same skin, with so many sub-layers of soft tissue and of muscle."""
    base = METHODS[m.PD]

    def bind(face: Face) -> SolvedRig:
        return _bind(base, replace(face, head=head, choices={**face.choices, "layers": layers}))

    return replace(base, name=name, bind=bind)


def _bind(method: Method, face: Face) -> SolvedRig:
    """Bind a solver."""
    rig = method.bind(face)
    assert isinstance(rig, SolvedRig)
    return rig


def _at_rest(method: Method) -> Method:
    """Take the settled neutral face of a solver for its frame, in place of that drawn to it again by targets."""

    def bind(face: Face) -> SolvedRig:
        settled = _bind(method, face).settled
        assert settled is not None
        told = {} if settled.solution is None else {"iterations": settled.solution.iterations}
        return SolvedRig(face.skin, lambda weights: Solved(settled.skin, settled.positions, told), settled)

    return replace(method, bind=bind)


def _loosen(method: Method) -> Method:
    """Solve expressions to LOOSE."""
    assert method.solver is not None
    solver = replace(method.solver, tolerance=LOOSE)
    return replace(method, solver=solver, bind=use_solver(solver, method.cells))


def _find_face(head: LayeredHead) -> np.ndarray:
    """Find the skin's vertices (n,) of the face; all of a head without that region."""
    return head.on_skin(["face"]) if "face" in head.regions else np.ones(len(head.skin.vertices), dtype=bool)


def _refine(person: Person, effect: str) -> Values:
    """Solve an effect on the left cheek by quadratic tets on three nested meshes; see `MeshError.note`."""
    head, p = person.head, EFFECTS[effect]
    scene, used = keep_used(neutral_scene(head, p, cells="tets", region=_left_cheek(head)))
    skin = used[used < len(head.bone)]
    carried = carry_by_bones(head, p)
    start = carried[used]
    skins: list[Floats] = []
    tets: list[int] = []
    for mesh in ("its own mesh", "split into eight", "split into 64"):
        if skins:
            scene, ends = refine_scene(scene)
            start = carry(start, ends)
        how = {"solver": "fenicsx", "element": "P2", "tolerance": TOLERANCE}
        start = solve_to_end(scene, f"quadratic tets, {mesh}", start=start, **how).positions
        places = carried[: len(head.bone)].copy()
        places[skin] = start[: len(skin)]
        skins.append(head.skin.vertices + head.skin_from_wrap @ (places - head.skin_wrap.vertices))
        tets.append(len(scene.tets))
    limit, order = extrapolate(*skins)
    motion = np.linalg.norm(limit - head.skin.vertices - carry_skin(head, p), axis=1)
    step, left = (measure(distances(skins[1], other), motion).share for other in (skins[2], limit))
    return {"rows": [], "share": step, "order": order, "left": left, "tets": tets}


def _left_cheek(head: LayeredHead) -> np.ndarray:
    """Mask the wraps' vertices (n,) of the left cheek; the left half of a head without regions."""
    left = head.skin_wrap.vertices[:, 0] > 0.0
    return left & (cheek_share(head) > 0.0) if "lips" in head.regions else left


def tell_distance(rows: Sequence[Row]) -> str:
    """Tell how far the simulator is from converged finite elements, by rows of `mesh`; nothing without them."""
    told = []
    for kind in ("effects", "expressions"):
        prisms, tets = (mean_share(rows, name, kind) for name in (m.PD, m.PD_TETS))
        if prisms is not None and tets is not None:
            told.append(f"{100 * prisms:.0f} % of the motion over {kind} (by tets {100 * tets:.0f} %)")
    return f"The simulator misses converged finite elements by {' and '.join(told)}." if told else ""


def mean_share(rows: Sequence[Row], method: str, kind: str) -> float | None:
    """Average the share of the motion that a method misses to quadratic tets, over rows of a kind or effect."""
    lines = (line for row in rows for line in row.values["rows"] if kind in (line["kind"], line["what"]))
    shares = [line["to"][m.FENICSX_P2]["share"] for line in lines if line["method"] == method and line["to"]]
    return float(np.mean(shares)) if shares else None
