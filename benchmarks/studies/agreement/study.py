"""One head's expressions by every solver, another law, the surrogate and blendshapes: how far apart they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ....animation.page import Pose, Rig, render_face_page
from ....animation.pictures import draw_cut_away
from ....animation.plots import subplots, to_svg
from ....lhm import check_head, expressions, identities
from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....reference import Parameters, open_jaw_scene, push_cheek_scene
from ....surrogate import Surrogate
from ....surrogate.methods import (
    BLENDSHAPES,
    FENICSX,
    FENICSX_NEO_HOOKEAN,
    NETWORK,
    PD,
    PD_PLAIN,
    SKFEM,
    SKFEM_NEO_HOOKEAN,
)
from ...harness.study import Column, Row, Study, Table, Task, Values, above, at_most
from ..measures import ACCURACY
from ..person import Person, person
from .faces import ALL, BESIDE, LAW, SKIN, TO_FENICSX, TO_PD, SolvedExpression, SolvedScene
from .insides import tabulate_insides

SOLVERS = (FENICSX, PD, PD_PLAIN, SKFEM, FENICSX_NEO_HOOKEAN, SKFEM_NEO_HOOKEAN)
FEWER = (FENICSX, PD, FENICSX_NEO_HOOKEAN)
"""Solvers of the scenes that tell laws apart; scikit-fem and plain PD are checked on the others."""
HEAD, FIT, TURNED = "the head", "fit and gates", "the head in 3D"
VIEW_WORDS = "Turn it with the mouse or a finger. In the poses the solvers' own answers can be chosen and compared."


@dataclass(frozen=True)
class Agreement(Study):
    """Expressions, a face under more gravity and with more volume, and two that no target holds; of a mean head."""

    name = "agreement"
    heading = "Does the fast simulator agree with finite elements?"
    question = (
        "Do projective dynamics, FEniCSx and scikit-fem find the same face, and how far are a hyperelastic law, the "
        "surrogate and blendshapes from it?"
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
        "PD, FEniCSx and scikit-fem solve PD's energy on the same tets. The neo-Hookean law has the same small-strain "
        "moduli and settles the neutral face itself. Distances are those of vertices. No target holds the skin where "
        "a bone opens the jaw or a load pushes the cheek. Springs hold the lining of mouth and eyes there, since no "
        "bone lies behind it. Iterations to 0.01 mm count until no vertex is farther from the answer. FEniCSx starts "
        "at rest. Where it ends in another minimum than PD, it also starts at PD's answer: PD is right if FEniCSx "
        "stays there. The study `work-precision` has the seconds, measured with nothing beside them."
    )
    version = 2

    identities: str = option("anny", "'anny', ict:FILE, flame:FILE or folder:DIR")
    expressions: tuple[str, ...] = option(
        ("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker", "cheekPuff", "browInnerUp"),
        "as jawOpen*0.5+cheekPuff; repeat for several",
    )
    gravity: float = option(3.0, "g of the scene that has no expression")
    volume: float = option(1.4, "times that of soft tissue, without an expression; 1: no such")
    jaw: float = option(12.0, "degrees by which its bone opens a jaw, at 2 g; 0: no such scene")
    push: float = option(0.25, "kPa that push a cheek; 0: no such scene")
    weights: str = option("", "of `softdeca train`  [those that are shipped]")

    def tasks(self) -> Sequence[Task]:
        """List the head, and each case by each method; InputError for an unknown space or expression."""
        for text in self.expressions:
            expressions.parse_weights(text)
        ranges = ("gravity", 0, 10, "g"), ("volume", 0.5, 2, "times"), ("jaw", 0, 30, "degrees"), ("push", 0, 2, "kPa")
        for name, low, high, unit in ranges:
            if not low <= (value := getattr(self, name)) <= high:
                raise InputError(f"{name}: expected {low:g} to {high:g} {unit}, got {value:g}")
        skins = (*((NETWORK,) if self.network() is not None else ()), BLENDSHAPES)
        methods = {case: (*SOLVERS, *skins, BESIDE) for case in (*self.expressions, self._heavy)}
        methods |= {self._grown: (*FEWER, *skins, BESIDE)} if self.volume != 1.0 else {}
        methods |= {case: (*FEWER, BESIDE) for case in self._free}
        cases = [Task(case, method) for case, by in methods.items() for method in by]
        return [Task(HEAD, FIT), *cases, Task(TURNED, BESIDE)]

    def person(self) -> Person:
        """Give the mean head of the space, made once per process."""
        return person(self.identities, None)

    def network(self) -> Surrogate | None:
        """Load the network that was asked for, else the one that is shipped for the space, if there is one."""
        if self.weights:
            return Surrogate.load(Path(self.weights))
        shipped = Surrogate.load()
        return shipped if shipped.space == identities.from_text(self.identities).name else None

    @property
    def _heavy(self) -> str:
        return f"gravity {self.gravity:g} g"

    @property
    def _grown(self) -> str:
        return f"soft tissue of {self.volume:g} times the volume"

    @property
    def _free(self) -> Sequence[str]:
        """The cases in which no target holds the skin."""
        return [case for case, size in ((self._open, self.jaw), (self._pushed, self.push)) if size > 0.0]

    @property
    def _open(self) -> str:
        return f"jaw opened by its bone, {self.jaw:g} degrees"

    @property
    def _pushed(self) -> str:
        return f"cheek pushed by {self.push:g} kPa"

    def make(self, case: str) -> SolvedScene:
        """Make a case of which nothing is solved."""
        of, still = self.person(), np.zeros(52)
        if case == self._open:
            return SolvedScene(of, open_jaw_scene(of.head, Parameters(gravity=2.0), angle=self.jaw))
        if case == self._pushed:
            return SolvedScene(of, push_cheek_scene(of.head, Parameters(), pressure=self.push))
        if case == self._heavy:
            return SolvedExpression(of, still, Parameters(gravity=self.gravity), self.network())
        if case == self._grown:
            return SolvedExpression(of, still, Parameters(soft_volume=self.volume), self.network())
        return SolvedExpression(of, expressions.parse_weights(case), Parameters(), self.network())

    def measure(self, task: Task) -> Values:
        """Measure a solve and its distances; the head's gates and picture; pictures of a case; the head in 3D."""
        of = self.person()
        if task.case == HEAD:
            figures = [(each.words, each.value, each.unit, each.limit) for each in check_head(of.head).figures]
            return {"tets": len(of.head.tets), "figures": figures, CUT: draw_cut_away(of.head)}
        if task.case == TURNED:
            at_rest, network = of.face(Parameters()), self.network()
            rigs, poses = [], []
            if network is not None:
                rigs.append(Rig.baked(NETWORK, network.bind_face(at_rest)))
            for text in self.expressions:
                face, weights = _face(self, text), expressions.parse_weights(text)
                poses.append(
                    Pose(text, weights, {PD: face.skin(face.pd[0]), FENICSX_NEO_HOOKEAN: face.law_skin(face.neo[0])})
                )
            title = f"the head ({of.space.name})"
            page = render_face_page(title, VIEW_WORDS, at_rest, rigs, poses)
            return {"blendshapes, PD, FEniCSx and network": page.encode()}
        face = _face(self, task.case)
        if task.method == BESIDE:
            return {PICTURED if isinstance(face, SolvedExpression) else FREE: face.picture()}
        if isinstance(face, SolvedExpression) and task.method in (NETWORK, BLENDSHAPES):
            return face.compare_skins(task.method)
        return face.solve_by(task.method)

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give a line for each comparison, the first with what the solver did; none of pictures."""
        compared: Sequence[Mapping] = values.get("compared", [])
        own = {key: value for key, value in values.items() if key != "compared"}
        return [{**(own if k == 0 else {}), **one} for k, one in enumerate(compared)]

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all give one answer, no tet is turned, all was reached that was asked, and acceleration pays.

        That PD is FEniCSx to 1e-6 excludes another law, whose least distance is above 1e-3 of the largest displacement,
        and plain PD, stopped at 0.005 mm.
        """
        gates = []
        for what, method in (
            ("PD to FEniCSx, same energy", PD),
            ("scikit-fem to FEniCSx, PD's energy", SKFEM),
            ("scikit-fem to FEniCSx, neo-Hookean", SKFEM_NEO_HOOKEAN),
        ):
            shares = [row.values["compared"][0]["relative"] for row in rows if row.method == method]
            if shares:
                bound = 1e-6 if method == PD else 1e-8
                gates.append(at_most(f"{what}, of the largest displacement", max(shares), bound))
        of_pd = [row for row in rows if row.method == PD]
        if of_pd:
            least = min(row.values["least_ratio"] for row in of_pd)
            gates.append(above("smallest volume ratio of a tet over all scenes (none inverted)", least, 0.0))
        unfinished = sum(not row.values.get("done", True) for row in rows)
        gates.append(at_most("solver runs that did not reach what was asked", unfinished, 0))
        counts = {(row.case, row.method): row.values["to_001_mm"] for row in rows if row.method in (PD, PD_PLAIN)}
        pairs = [
            (counts[case, PD], slow) for (case, by), slow in counts.items() if by == PD_PLAIN and (case, PD) in counts
        ]
        if pairs:
            # None where one does not come to 0.01 mm.
            ratios = [None if None in pair else pair[0] / max(pair[1], 1) for pair in pairs]
            worst = None if None in ratios else max(ratio for ratio in ratios if ratio is not None)
            what = "accelerated PD's iterations to 0.01 mm over plain PD's, worst scene"
            gates.append(at_most(what, worst, 0.2, answer=False))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell whether the answers are one, what another law changes, where two minima are, and what rigs leave."""
        sentences = []
        first = [row.values["compared"][0]["relative"] for row in rows if row.method == PD]
        if first:
            sentences.append(
                "Projective dynamics and FEniCSx find the same minimiser of the same energy to "
                f"{max(first):.1e} of the largest displacement in all {len(first)} scenes."
            )
        twice = {
            row.case: row.values["another_minimum_mm"]
            for row in rows
            if row.method == FENICSX and row.values["another_minimum_mm"] is not None
        }
        if twice:
            sentences.append(
                f"PD's energy has two minima on {', '.join(twice)}: FEniCSx from rest ends up to "
                f"{max(twice.values()):.2f} mm away; answers are compared at PD's."
            )
        for free, where in ((False, "where targets hold it"), (True, "where none does")):
            of = [row for row in rows if row.method == FENICSX_NEO_HOOKEAN and (row.case in self._free) is free]
            lines = [line for row in of for line in row.values["compared"]]
            if lines:
                mean = max(line["mean"] for line in lines if line["compared"] == TO_PD + SKIN)
                most = max(line["max"] for line in lines if line["compared"] == TO_PD + ALL)
                sentences.append(
                    f"A neo-Hookean law moves the skin by at most {mean:.3f} mm on average {where}, and any vertex by "
                    f"at most {most:.2f} mm."
                )
        for method in (NETWORK, BLENDSHAPES):
            lines = [line for row in rows if row.method == method for line in row.values["compared"]]
            means = [line["mean"] for line in lines if line["compared"] == TO_PD + SKIN]
            if means:
                sentences.append(f"The skin by {method} is at most {max(means):.3f} mm from PD's on average.")
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate the gates of the head, how near the skin comes to its targets, and what the law changes inside."""
        figures = [figure for row in rows for figure in row.values.get("figures", [])]
        tables = [Table("The head", ["figure", "measured", "unit", "gate"], figures)] if figures else []
        left = [
            (row.case, *row.values["lips_mm"], row.values["least_ratio"]) for row in rows if "lips_mm" in row.values
        ]
        if left:
            head = ["scene", "lips to their targets, median [mm]", "95 % [mm]", "max [mm]", "smallest volume ratio"]
            tables.append(Table("What PD leaves", head, left))
        return tables + tabulate_insides(rows, PD, LAW)

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw distances, a line per scene: means, and of the law the largest of all vertices too."""
        marks = {
            (PD, TO_FENICSX + ALL, "mean"): "PD to FEniCSx, same energy",
            (SKFEM, TO_FENICSX + ALL, "mean"): "scikit-fem to FEniCSx, same energy",
            (FENICSX_NEO_HOOKEAN, TO_PD + SKIN, "mean"): "neo-Hookean law to PD, skin",
            (FENICSX_NEO_HOOKEAN, TO_PD + ALL, "max"): "the same, all vertices, largest",
            (NETWORK, TO_PD + SKIN, "mean"): "network to PD, skin",
            (BLENDSHAPES, TO_PD + SKIN, "mean"): "blendshapes to PD, skin",
        }
        cases = list(dict.fromkeys(row.case for row in rows if row.case not in (HEAD, TURNED)))
        shown = {
            label: [
                (max(line[key], 1e-14), cases.index(row.case))
                for row in rows
                if row.method == method
                for line in row.values["compared"]
                if line["compared"] == what
            ]
            for (method, what, key), label in marks.items()
        }
        if not any(shown.values()):
            return {}
        figure, axis = subplots(figsize=(10, 0.45 * len(cases) + 1.7))
        for label, points in shown.items():
            if points:
                axis.plot(*zip(*points, strict=True), "o", label=label)
        axis.axvline(ACCURACY, color="#bbbbbb", lw=0.8, ls=":")
        axis.set(xscale="log", xlabel="distance of the vertices, mean unless said [mm]; dotted: 0.01 mm")
        axis.set_yticks(range(len(cases)), cases)
        axis.invert_yaxis()
        axis.grid(False, axis="y")
        figure.legend(loc="outside upper center", ncol=3)
        return {"How far apart: solvers of one energy, another law, the surrogate, blendshapes.": to_svg(figure)}


PICTURED = "target; simulated; and as colours [mm] on the simulated face, how far the others are from it"
FREE = "at rest; simulated; under the law; and as colours [mm] how far the law's face is from the simulated"
CUT = "soft tissue (yellow) and muscle (red) cut open; the skin wrap; the skull wrap: cranium white, mandible blue"


@cache
def _face(study: Agreement, case: str) -> SolvedScene:
    return study.make(case)
