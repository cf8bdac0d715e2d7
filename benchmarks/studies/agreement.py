"""One head's expressions by every solver, another law, the surrogate and blendshapes: how far apart they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from ...lhm import check_head, expressions, identities
from ...lhm.errors import InputError
from ...lhm.mesh import Floats
from ...reference import Parameters, Scene, Solution, neo_hookean_scene, prepare, settled, solve
from ...surrogate import Surrogate
from ...viewer import Pose, Rig, face_page
from ...viewer.pictures import Panel, cut_away, strip
from ..differences import difference, distances
from ..harness.gates import above, at_most
from ..harness.runner import Row
from ..harness.study import Column, Study, Table, Task, Values
from ..plots import subplots, svg
from ..traces import ACCURACY, TIGHT, Trace, traced, traced_to_itself
from .person import Person, person

WARM = 1e-9
"""Gradient norm over its start of those that start at PD's answer, where it is smaller already."""
ROUGH = 1e-6
"""PD is stopped here to start scikit-fem, whose part is to check the answer and not to be fast."""
APART = 1e-4
"""Of the largest displacement: converged answers that are farther apart than this are two minima."""
PLAIN_STOP, PLAIN_LIMIT = 0.005, 4000
"""Plain projective dynamics stops here [mm], below what its iterations are counted to, or after so many."""
PD, PLAIN, FENICSX, SKFEM = "PD", "PD, plain", "FEniCSx Newton", "scikit-fem Newton"
NEO, NEO_SKFEM = "FEniCSx, neo-Hookean", "scikit-fem, neo-Hookean"
SURROGATE, BLENDSHAPES, BESIDE = "surrogate", "blendshapes (T = S)", "side by side"
SOLVERS = (FENICSX, PD, PLAIN, SKFEM, NEO, NEO_SKFEM)
HEAD, FIT, TURNED = "the head", "fit and gates", "the head in 3D"
TO_PD, TO_FENICSX, TO_NEO = "to PD", "to FEniCSx", "to neo-Hookean"
ALL, SKIN = ", all vertices", ", skin"
VIEW_WORDS = "Turn it with the mouse or a finger. In the poses the solvers' own answers can be chosen and compared."


@dataclass(frozen=True)
class Agreement(Study):
    """Expressions, and a face under more gravity without one, of the mean head of a space."""

    name = "agreement"
    heading = "Does the fast simulator agree with finite elements?"
    question = (
        "Do projective dynamics, FEniCSx and scikit-fem find the same face, and how far from it are a hyperelastic "
        "law, the surrogate and plain blendshapes?"
    )
    columns = (
        Column("compared", "compared"),
        Column("mean", "mean [mm]"),
        Column("rms", "RMS [mm]"),
        Column("p95", "95 % [mm]"),
        Column("max", "max [mm]"),
        Column("relative", "max / largest displacement"),
        Column("start", "start"),
        Column("iterations", "iterations", cost=True),
        Column("to_001_mm", "iterations to 0.01 mm", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("gradient", "gradient / start"),
        Column("reason", "ended"),
    )
    note = (
        "PD, FEniCSx and scikit-fem on PD's energy and the same tets; the neo-Hookean law has the same small-strain "
        "moduli. Distances of vertices. Iterations to 0.01 mm: until no vertex is farther from the answer. Where "
        "FEniCSx, which starts at rest, ends in another minimum than PD, it is started at PD's answer too: PD is right "
        "if FEniCSx stays there. Seconds are in the study `work-precision`, where nothing runs beside them."
    )

    identities: str = field(default="anny", metadata={"help": "'anny', ict:FILE, flame:FILE or folder:DIR"})
    expressions: tuple[str, ...] = field(
        default=("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker", "cheekPuff", "browInnerUp"),
        metadata={"help": "as jawOpen*0.5+cheekPuff; repeat for several"},
    )
    gravity: float = field(default=3.0, metadata={"help": "g of the scene that has no expression"})
    weights: str = field(default="", metadata={"help": "of `softdeca train`  [those that are shipped]"})

    def tasks(self) -> Sequence[Task]:
        """The head, and each case by each method; InputError for a space or an expression that cannot be read."""
        for text in self.expressions:
            expressions.parsed(text)
        if not 0.0 <= self.gravity <= 10.0:
            raise InputError(f"gravity: expected 0 to 10 g, got {self.gravity:g}")
        learned = (SURROGATE,) if self.network() is not None else ()
        methods = (*SOLVERS, *learned, BLENDSHAPES, BESIDE)
        cases = [Task(case, method) for case in (*self.expressions, self._heavy) for method in methods]
        return [Task(HEAD, FIT), *cases, Task(TURNED, BESIDE)]

    def person(self) -> Person:
        """The mean head of the space, made once per process."""
        return person(self.identities, None)

    def network(self) -> Surrogate | None:
        """The one that was asked for, else the one that is shipped for the space, if there is one."""
        if self.weights:
            return Surrogate.load(Path(self.weights))
        shipped = Surrogate.load()
        return shipped if shipped.space == identities.from_text(self.identities).name else None

    @property
    def _heavy(self) -> str:
        return f"gravity {self.gravity:g} g"

    def face(self, case: str) -> Face:
        """A case with what this process has solved of it."""
        return _face(self, case)

    def make(self, case: str) -> Face:
        """A case of which nothing is solved."""
        if case == self._heavy:
            return Face(self.person(), np.zeros(52), Parameters(gravity=self.gravity), self.network())
        return Face(self.person(), expressions.parsed(case), Parameters(), self.network())

    def measure(self, task: Task) -> Values:
        """A solve and its distances; the head's gates and picture; pictures of a case; the head in 3D."""
        if task.case == HEAD:
            return self._fitted()
        if task.case == TURNED:
            return {"blendshapes, PD, FEniCSx and surrogate": self._turned().encode()}
        face = self.face(task.case)
        if task.method == BESIDE:
            return {PICTURED: face.picture()}
        return face.skins_compared(task.method) if task.method in (SURROGATE, BLENDSHAPES) else face.solved(task.method)

    def _fitted(self) -> Values:
        head = self.person().head
        figures = [(each.words, each.value, each.unit, each.limit) for each in check_head(head).figures]
        return {"tets": len(head.tets), "figures": figures, CUT: cut_away(head)}

    def _turned(self) -> str:
        of, network, parameters = self.person(), self.network(), Parameters()
        shapes = of.space.expression_deltas(of.code)
        rigs = []
        if network is not None:
            rigs = [Rig.baked("surrogate", network.bind(of.head.skin, of.code, parameters, expressions=shapes))]
        poses = []
        for text in self.expressions:
            face = self.face(text)
            poses.append(
                Pose(text, face.weights, {"PD": face.skin(face.pd[0]), "FEniCSx, neo-Hookean": face.skin(face.neo[0])})
            )
        return face_page(f"the head ({of.space.name})", VIEW_WORDS, of.head, parameters, shapes, rigs, poses)

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """A comparison each, the first with what the solver did; none of pictures."""
        compared: Sequence[Mapping] = values.get("compared", [])
        own = {key: value for key, value in values.items() if key != "compared"}
        return [{**(own if k == 0 else {}), **one} for k, one in enumerate(compared)]

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """One answer from all, no tet turned, all that was asked reached; acceleration pays."""
        found = []
        for what, method in (
            ("PD to FEniCSx-Newton, same energy", PD),
            ("scikit-fem to FEniCSx, PD's energy", SKFEM),
            ("scikit-fem to FEniCSx, neo-Hookean", NEO_SKFEM),
        ):
            shares = [row.values["compared"][0]["relative"] for row in rows if row.method == method]
            if shares:
                bound = 1e-6 if method == PD else 1e-8
                found.append(at_most(f"{what}, of the largest displacement", max(shares), bound))
        of_pd = [row for row in rows if row.method == PD]
        if of_pd:
            least = min(row.values["least_ratio"] for row in of_pd)
            found.append(above("smallest volume ratio of a tet over all scenes (none inverted)", least, 0.0))
        unfinished = sum(not row.values.get("done", True) for row in rows)
        found.append(at_most("solver runs that did not reach what was asked", unfinished, 0))
        ratios = _iteration_ratios(rows)
        if ratios:
            worst = None if None in ratios else max(ratio for ratio in ratios if ratio is not None)
            what = "accelerated PD's iterations to 0.01 mm over plain PD's, worst scene"
            found.append(at_most(what, worst, 0.2, answer=False))
        return found

    def words(self, rows: Sequence[Row]) -> str:
        """Whether the answers are one, what another law changes, where there are two minima, what the rigs leave."""
        said = []
        first = [row.values["compared"][0]["relative"] for row in rows if row.method == PD]
        if first:
            said.append(
                "Projective dynamics and FEniCSx find the same minimiser of the same energy to "
                f"{max(first):.1e} of the largest displacement in all {len(first)} scenes."
            )
        for row in rows:
            if row.method == FENICSX and row.values["another_minimum_mm"] is not None:
                said.append(
                    f"{row.case} has two minima of PD's energy: FEniCSx from rest ends "
                    f"{row.values['another_minimum_mm']:.2f} mm from PD's answer at most, and from PD's answer it "
                    "stays there; the comparisons are at that one."
                )
        law = _means(rows, NEO, TO_PD + SKIN)
        if law:
            said.append(
                "A neo-Hookean law of the same small-strain moduli in place of PD's energy moves the skin by "
                f"{min(law):.3f} to {max(law):.3f} mm on average."
            )
        for method in (SURROGATE, BLENDSHAPES):
            means = _means(rows, method, TO_PD + SKIN)
            if means:
                said.append(f"The skin by {method} is {min(means):.3f} to {max(means):.3f} mm from PD's on average.")
        return " ".join(said)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """The gates of the head, and how near the skin comes to its targets."""
        figures = [figure for row in rows for figure in row.values.get("figures", [])]
        found = [Table("The head", ["figure", "measured", "unit", "gate"], figures)] if figures else []
        left = [(row.case, *row.values["lips_mm"], row.values["least_ratio"]) for row in rows if row.method == PD]
        if left:
            head = ["scene", "lips to their targets, median [mm]", "95 % [mm]", "max [mm]", "smallest volume ratio"]
            found.append(Table("What PD leaves", head, left))
        return found

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Mean distances on the skin, a line per scene."""
        marks = {
            (PD, TO_FENICSX + ALL): "PD to FEniCSx, same energy",
            (SKFEM, TO_FENICSX + ALL): "scikit-fem to FEniCSx, same energy",
            (NEO, TO_PD + SKIN): "neo-Hookean law to PD",
            (SURROGATE, TO_PD + SKIN): "surrogate to PD",
            (BLENDSHAPES, TO_PD + SKIN): "blendshapes to PD",
        }
        cases = list(dict.fromkeys(row.case for row in rows if row.case not in (HEAD, TURNED)))
        shown = {
            label: [
                (max(line["mean"], 1e-14), cases.index(row.case))
                for row in rows
                if row.method == method
                for line in row.values["compared"]
                if line["compared"] == what
            ]
            for (method, what), label in marks.items()
        }
        if not any(shown.values()):
            return {}
        figure, axis = subplots(figsize=(10, 0.45 * len(cases) + 1.7))
        for label, points in shown.items():
            if points:
                axis.plot(*zip(*points, strict=True), "o", label=label)
        axis.axvline(ACCURACY, color="#bbbbbb", lw=0.8, ls=":")
        axis.set(xscale="log", xlabel="mean distance of the vertices [mm]; dotted: 0.01 mm")
        axis.set_yticks(range(len(cases)), cases)
        axis.invert_yaxis()
        axis.grid(False, axis="y")
        figure.legend(loc="outside upper center", ncol=3)
        return {"How far apart: solvers of one energy, another law, the surrogate, blendshapes.": svg(figure)}


PICTURED = "target; simulated; and as colours [mm] on the simulated face, how far the others are from it"
CUT = "soft tissue (yellow) and muscle (red) cut open; the skin wrap; the skull wrap: cranium white, mandible blue"


class Face:
    """One face under p with its targets, and what has been solved of it: each once."""

    def __init__(self, of: Person, weights: Floats, parameters: Parameters, network: Surrogate | None):
        self.of, self.weights, self.parameters, self._network = of, weights, parameters, network
        self.shape = of.blend(weights[None])[0]
        self._settled = settled(of.head, parameters)
        self.scene = self._settled.scene(self.shape)
        self.targets = self._settled.targets(self.shape)

    @cached_property
    def pd(self) -> tuple[Solution, Trace]:
        """PD's tight answer, and the way to it."""
        return traced_to_itself(prepare(self.scene))

    @cached_property
    def fenicsx(self) -> tuple[Solution, float | None]:
        """FEniCSx' answer to the same energy; and how far [mm] from PD's it ends from rest, where that is another."""
        answer, rest = self.pd[0].positions, self.scene.vertices
        solution = solve(self.scene, solver="fenicsx", tolerance=TIGHT)
        beside = difference(solution.positions, answer, rest)
        if beside.relative <= APART:
            return solution, None
        return solve(self.scene, solver="fenicsx", start=answer, tolerance=WARM), beside.max

    @cached_property
    def neo(self) -> tuple[Solution, Scene, Floats | None]:
        """The neo-Hookean law's answer by FEniCSx, its scene, and its start: PD's answer, or None for rest."""
        pd = self.pd[0]
        # Its energy is infinite where a tet is inverted: then PD's answer is no start for it.
        start = pd.positions if pd.volume_ratio.min() > 0 else None
        scene = neo_hookean_scene(self.scene)
        return solve(scene, solver="fenicsx", tolerance=WARM, start=start), scene, start

    @cached_property
    def learned(self) -> Floats:
        """The surrogate's skin [mm]."""
        assert self._network is not None
        of = self.of
        shapes = of.space.expression_deltas(of.code)
        bound = self._network.bind(of.head.skin, of.code, self.parameters, expressions=shapes)
        return np.asarray(bound.frame(self.weights), dtype=np.float64)

    def skin(self, solution: Solution) -> Floats:
        """The skin [mm] of an answer."""
        return self.of.head.skin_after(self.targets, solution.positions[: len(self.of.head.bone)])

    def solved(self, method: str) -> dict:
        """What a solver did, and how far its answer is from the others'."""
        if method == PD:
            solution, trace = self.pd
            lips = self.of.head.regions["lips"]
            wrap = solution.positions[: len(self.of.head.bone)]
            left = distances(wrap, self.of.head.wrap_targets(self.targets))[lips]
            return _row(solution, "rest", self._between(solution, TO_FENICSX, self.fenicsx[0])) | {
                "to_001_mm": trace.settled(ACCURACY),
                "least_ratio": float(solution.volume_ratio.min()),
                "lips_mm": [float(np.median(left)), float(np.percentile(left, 95)), float(left.max())],
            }
        if method == PLAIN:
            plain, truth = prepare(self.scene, method="plain"), self.pd[0].positions
            solution, trace = traced(plain, truth, enough=PLAIN_STOP, max_iterations=PLAIN_LIMIT)
            reached = trace.settled(ACCURACY)
            row = _row(solution, "rest", self._between(solution, TO_PD, self.pd[0]))
            return row | {"to_001_mm": reached, "done": reached is not None}
        if method == FENICSX:
            solution, another = self.fenicsx
            begun = "rest" if another is None else "PD's answer"
            return _row(solution, begun, self._between(solution, TO_PD, self.pd[0])) | {"another_minimum_mm": another}
        if method == SKFEM:
            rough = solve(self.scene, tolerance=ROUGH).positions
            solution = solve(self.scene, solver="skfem", tolerance=TIGHT / ROUGH, start=rough)
            return _row(solution, "PD, stopped early", self._between(solution, TO_FENICSX, self.fenicsx[0]))
        solution, scene, start = self.neo
        said = "rest" if start is None else "PD's answer"
        if method == NEO:
            skins = difference(self.skin(solution), self.skin(self.pd[0]), self.of.head.skin.vertices)
            between = self._between(solution, TO_PD, self.pd[0])
            return _row(solution, said, [*between, {"compared": TO_PD + SKIN, **asdict(skins)}])
        checked = solve(scene, solver="skfem", tolerance=WARM, start=start)
        return _row(checked, said, self._between(checked, TO_NEO, solution))

    def skins_compared(self, method: str) -> dict:
        """How far the surrogate's skin, or that of blendshapes, is from the solvers'."""
        skin, rest = self.learned if method == SURROGATE else self.shape, self.of.head.skin.vertices
        others = {TO_PD: self.pd[0], TO_FENICSX: self.fenicsx[0], TO_NEO: self.neo[0]}
        return {
            "compared": [
                {"compared": what + SKIN, **asdict(difference(skin, self.skin(other), rest))}
                for what, other in others.items()
            ]
        }

    def picture(self) -> bytes:
        """Target, simulated, and the distances of blendshapes, neo-Hookean law and surrogate: PNG."""
        pd, head = self.skin(self.pd[0]), self.of.head
        simulated = head.skin.with_vertices(pd)
        others = {"blendshapes - PD": self.shape, "neo-Hookean - PD": self.skin(self.neo[0])}
        others |= {} if self._network is None else {"surrogate - PD": self.learned}
        errors = {text: distances(skin, pd) for text, skin in others.items()}
        top = max(0.05, float(np.percentile(errors["blendshapes - PD"], 99.5)))
        panels = [Panel("target", head.skin.with_vertices(self.shape)), Panel("simulated (PD)", simulated)]
        panels += [Panel(text, simulated, error, top) for text, error in errors.items()]
        return strip([replace(panel, weights=self.weights) for panel in panels], rest=head.skin)

    def _between(self, solution: Solution, what: str, other: Solution) -> list[dict]:
        apart = difference(solution.positions, other.positions, self.scene.vertices)
        return [{"compared": what + ALL, **asdict(apart)}]


@cache
def _face(study: Agreement, case: str) -> Face:
    return study.make(case)


def _row(solution: Solution, start: str, compared: Sequence[dict]) -> dict:
    norms = solution.history.gradient_norm
    return {
        "compared": compared,
        "start": start,
        "iterations": solution.iterations,
        "linear_iterations": solution.detail.get("linear_iterations"),
        "gradient": float(norms[-1] / norms[0]) if norms[0] > 0 else 0.0,
        "reason": solution.reason.name,
        "done": solution.converged,
    }


def _means(rows: Sequence[Row], method: str, what: str) -> list[float]:
    lines = [line for row in rows if row.method == method for line in row.values["compared"]]
    return [line["mean"] for line in lines if line["compared"] == what]


def _iteration_ratios(rows: Sequence[Row]) -> list[float | None]:
    """Of each scene that both have solved; None where one does not come to 0.01 mm."""
    counts = {(row.case, row.method): row.values["to_001_mm"] for row in rows if row.method in (PD, PLAIN)}
    pairs = [(count, counts[case, PLAIN]) for (case, method), count in counts.items()
             if method == PD and (case, PLAIN) in counts]  # fmt: skip
    return [None if fast is None or slow is None else fast / max(slow, 1) for fast, slow in pairs]
