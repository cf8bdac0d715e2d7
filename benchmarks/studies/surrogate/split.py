"""Where a frame's error comes from: the network, the corpus' tolerance, PD's energy as a law, and the mesh.

Each law settles the neutral face by itself, and so do quadratic tets. They are solved for every row on the coarsest
level of the template, and for some rows on the study's own level too. The other rows' part of the mesh is estimated:
the coarse part times the ratio of fine to coarse parts, with the lowest and highest ratio as its band.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.expressions import parse_weights
from ....reference import Face, Parameters, Scene
from ....reference.face.settle import SettledFace, settle
from ....surrogate import methods as m
from ...contest import Case, run_contest
from ...harness.first_screen import find_lost_effects
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import distances, limit_of_two, solve_to_end
from ..person import OfPerson, check_known

EFFECTS: Mapping[str, Parameters] = {
    "defaults": Parameters(),
    "40 % more soft tissue": Parameters(soft_volume=1.4),
    "skin grown by 30 %": Parameters(skin_growth=1.3),
    "softer, 2 g": Parameters(soft_stiffness=2.0, gravity=2.0),
}
PARTS = {
    "network": "network - PD as trained",
    "tolerance": "PD as trained - PD converged",
    "law": "PD's energy - neo-Hookean",
    "mesh": "linear tets - quadratic tets",
}
RIVALS = {"carried": m.CARRIED, "settled": m.SETTLED}
"""Rivals without learning: blendshapes moved with the bones that p scales, or with the simulated neutral face."""
SHARE_KEYS = {
    "share": m.NETWORK,
    "share_carried": m.CARRIED,
    "share_settled": m.SETTLED,
    "share_derivatives": m.DERIVATIVES,
}
"""Keys of shares, and the methods that they are of."""
COARSE = 1
"""Level of the template at which the part of the mesh is measured for every row."""
FINE = ", quadratic tets"
"""End of the method of rows that measure the part of the mesh on the study's own level."""
QUADRATIC = 0.1
"""Gradient norm over its start of quadratic tets, which start at the linear answer: some two Newton steps.

Two expressions on level 1, solved to the end, moved the skin by another 3 and 5 % of the distance to linear tets.
"""
QUADRATIC_NEUTRAL = 0.005
"""The same of the neutral face: some three steps. With 40 % more tissue on level 1, two left 6 % of the distance."""
ORDER = 1.0
"""Order of quadratic tets' answers by level, assumed: levels differ in where the skin is tied, too."""


@dataclass(frozen=True)
class Split(OfPerson):
    """The error of the shipped network on a person it has not seen, part by part; expressions by effects."""

    name = "split"
    version = 4
    heading = "Where does the network's error come from?"
    question = (
        "Which part of the surrogate's error to a refined hyperelastic reference comes from the network, the training "
        "tolerance, PD's energy and the mesh?"
    )
    needs = ("people", "heads", "network")
    cheap = "defaults, cheekPuff"
    columns = (
        Column("moved", "|T - carried(S)|, mean [mm]"),
        *(Column(key, f"{title}, mean [mm]") for key, title in PARTS.items()),
        Column("mesh_coarse", f"linear - quadratic tets on level {COARSE}, mean [mm]"),
        Column("total", "network - neo-Hookean reference, mean [mm]"),
        Column("share", "network's share of |T - carried(S)|"),
        Column("share_carried", f"share of {RIVALS['carried']}"),
        Column("share_settled", f"share of {RIVALS['settled']}"),
        Column("share_derivatives", f"share of {m.DERIVATIVES}"),
        Column("fenicsx", "check: PD - FEniCSx, same energy, max [mm]"),
    )
    note = (
        "T is PD's converged skin, S are the blendshapes. Shares are taken where a vertex moves by more than 0.05 mm. "
        "Each law and element settles the neutral face by itself. Every row solves quadratic tets on level 1; the "
        "rows named `refined` solve them on the study's own level too. There `refined` is the distance to the limit "
        "of both levels' quadratic tets (Richardson, order 1 assumed; its bound is the GCI). The other rows estimate "
        "the part of the mesh; its band is that of the measured ratios."
    )

    expressions: tuple[str, ...] = option(
        ("jawOpen*0.5", "mouthSmileLeft*0.6+mouthSmileRight*0.6", "mouthPucker", "cheekPuff"),
        "as jawOpen*0.5+cheekPuff; repeat for several",
    )
    effects: tuple[str, ...] = option(tuple(EFFECTS), f"one of {', '.join(EFFECTS)}; repeat for several")
    seed: int = 1_000_003
    refined: tuple[str, ...] = option(
        ("defaults", "40 % more soft tissue"),
        "an effect with quadratic tets on the study's own level, first expression: minutes each",
    )

    def tasks(self) -> Sequence[Task]:
        """Name each effect with each expression: a process that goes on with an effect has prepared it."""
        self.check(self.expressions)
        check_known("effect", (*self.effects, *self.refined), EFFECTS)
        if not self.expressions:
            raise InputError("expressions: there is none")
        rows = [Task(name, text) for name in self.effects for text in self.expressions]
        return rows + [Task(name, self.expressions[0] + FINE) for name in self.refined]

    def measure(self, task: Task) -> Values:
        """Compare the skins of one frame by every method, or by quadratic tets on two levels."""
        if task.method.endswith(FINE):
            return self._measure_refined(task.case, task.method.removesuffix(FINE))
        lines = {line["method"]: line for line in self._run(task.case, task.method)}
        linear_coarse, quadratic_coarse = _solve_both(self, task.case, COARSE, task.method)
        for line in lines.values():
            if line["status"] != "done":
                raise SoftdecaError(f"{line['method']}: {line['reason']}")
        shares = {key: lines[label]["to"][m.PD]["share"] for key, label in SHARE_KEYS.items()}
        return {
            "moved": lines[m.CARRIED]["to"][m.PD]["everywhere"],
            "network": lines[m.NETWORK]["to"][m.PD_AS_TRAINED]["everywhere"],
            "tolerance": lines[m.PD_AS_TRAINED]["to"][m.PD]["everywhere"],
            "law": lines[m.FENICSX_NEO_HOOKEAN]["to"][m.PD]["everywhere"],
            "mesh_coarse": _measure_mean(linear_coarse, quadratic_coarse),
            "total": lines[m.NETWORK]["to"][m.FENICSX_NEO_HOOKEAN]["everywhere"],
            **shares,
            "fenicsx": lines[m.FENICSX]["to"][m.PD]["farthest"],
        }

    def _run(self, effect: str, text: str) -> Sequence[Mapping]:
        """The contest's rows of a frame."""
        face = self.person().face(EFFECTS[effect])
        case = Case(text, effect, lambda: replace(face), parse_weights(text)[None])
        truths = (m.PD, m.PD_AS_TRAINED, m.FENICSX_NEO_HOOKEAN)
        return run_contest(case, (m.FENICSX, *SHARE_KEYS.values()), truths)

    def _measure_refined(self, effect: str, text: str) -> Values:
        """Measure the part of the mesh on two levels, and to the limit of quadratic tets by level."""
        linear_coarse, quadratic_coarse = _solve_both(self, effect, COARSE, text)
        linear, quadratic = _solve_both(self, effect, self.level, text)
        limit = limit_of_two(quadratic_coarse, quadratic, ORDER)
        parts = linear - quadratic, linear_coarse - quadratic_coarse
        return {
            "mesh": _measure_mean(linear, quadratic),
            "mesh_max": float(distances(linear, quadratic).max()),
            "mesh_coarse": _measure_mean(linear_coarse, quadratic_coarse),
            "alike": float(np.sum(parts[0] * parts[1]) / np.sqrt(np.sum(parts[0] ** 2) * np.sum(parts[1] ** 2))),
            "refined": _measure_mean(linear, limit.positions),
            "refined_index": limit.index,
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that the reference holds, that the corpus is exact enough, and that the network beats its rivals."""
        frames = _select_frames(rows)
        if not frames:
            return []
        apart = max(row.values["fenicsx"] for row in frames)
        share = max(row.values["tolerance"] / row.values["network"] for row in frames)
        gates = [
            # PD stopped where the corpus stops misses it; what is left is rounding.
            at_most("PD to FEniCSx, same energy, largest distance of a vertex [mm]", apart, 2e-5),
            at_most("the corpus' tolerance over the network's error", share, 0.006),
        ]
        for effect, bound in SHARES.items():
            shares = [row.values["share"] for row in frames if row.case == effect]
            if shares:
                what = f"network's share of |T - carried(S)|, {effect}, mean"
                gates.append(at_most(what, float(np.mean(shares)), bound))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell each part's mean, which is the largest, and where a rival without learning beats the network."""
        frames = _select_frames(rows)
        if not frames:
            return ""
        means = {key: float(np.mean([row.values[key] for row in frames])) for key in PARTS if key != "mesh"}
        motion = float(np.mean([row.values["moved"] for row in frames]))
        sentences = [f"Simulation moves the skin by {motion:.2f} mm on average beyond what bones carry."]
        ratios, coarse = _find_ratios(rows), float(np.mean([row.values["mesh_coarse"] for row in frames]))
        parts = [f"{PARTS[key]} {mean:.3f} mm ({100.0 * mean / motion:.1f} %)" for key, mean in means.items()]
        if ratios:
            low, middle, high = (coarse * ratio for ratio in (min(ratios), float(np.mean(ratios)), max(ratios)))
            means["mesh"] = middle
            band = f"between {low:.3f} and {high:.3f}; measured in {len(ratios)} of the rows, else estimated"
            parts.append(f"{PARTS['mesh']} {middle:.3f} mm ({100.0 * middle / motion:.1f} %; {band})")
        largest = max(means, key=lambda key: means[key])
        sentences.append(f"Parts: {', '.join(parts)}. Most is {PARTS[largest]}.")
        if not ratios:
            sentences.append(f"On level {COARSE} alone linear tets are {coarse:.3f} mm from quadratic ones.")
        lost = find_lost_effects(frames)
        sentences += [f"{effect}: the network loses to {rival}." for effect, (rival, _, _) in lost.items()]
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Lay out the part of the mesh of every frame: measured or estimated, with its band."""
        fine = {(row.case, row.method.removesuffix(FINE)): row.values for row in rows if row.method.endswith(FINE)}
        ratios = _find_ratios(rows)
        tables = []
        if ratios:
            lines = []
            for row in _select_frames(rows):
                measured, coarse = fine.get((row.case, row.method)), row.values["mesh_coarse"]
                middle = measured["mesh"] if measured else coarse * float(np.mean(ratios))
                band = ("", "") if measured else (coarse * min(ratios), coarse * max(ratios))
                lines.append((row.case, row.method, coarse, middle, "measured" if measured else "estimated", *band))
            titles = ["effect", "expression", f"level {COARSE} [mm]", "this level [mm]", "", "lowest [mm]", "highest"]
            tables.append(Table("Linear to quadratic tets, mean over the skin", titles, lines))
            keys = ("mesh", "mesh_max", "mesh_coarse", "alike", "refined", "refined_index")
            titles = ["effect", "expression", "mean [mm]", "max [mm]", f"level {COARSE} [mm]",
                      "cosine of the two levels' fields", "to the limit, mean [mm]", "GCI [mm]"]  # fmt: skip
            caption = f"Where quadratic tets were solved on the study's own level and on level {COARSE}"
            tables.append(Table(caption, titles, [(*key, *(v[k] for k in keys)) for key, v in fine.items()]))
        return tables

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the parts as bars, a group per frame."""
        frames, ratios = _select_frames(rows), _find_ratios(rows)
        if not frames:
            return {}
        figure, axis = subplots(figsize=(11, 0.42 * len(frames) + 1.6))
        places = np.arange(len(frames))
        left = np.zeros(len(frames))
        for key in (key for key in PARTS if key != "mesh" or ratios):
            scale = float(np.mean(ratios)) if key == "mesh" else 1.0
            sizes = np.array([row.values["mesh_coarse" if key == "mesh" else key] * scale for row in frames])
            axis.barh(places, sizes, left=left, height=0.7, label=PARTS[key] + (", estimated" if key == "mesh" else ""))
            left += sizes
        motion = [row.values["moved"] for row in frames]
        axis.scatter(motion, places, marker="|", s=160, color="black", label="T - carried(S)")
        axis.set_yticks(places, [f"{row.case}, {row.method}" for row in frames], fontsize=8)
        axis.invert_yaxis()
        axis.set_xlabel("mean over the skin's vertices [mm]")
        figure.legend(loc="outside upper center", ncol=3)
        axis.grid(False, axis="y")
        return {"Mean distances, one after another; | is what simulation moves.": to_svg(figure)}


SHARES: Mapping[str, float] = {"defaults": 0.22, "skin grown by 30 %": 0.26, "softer, 2 g": 0.2}
"""Bound of the network's share by effect, below both rivals' shares. Effects in which it loses to one have none."""


def _select_frames(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if not row.method.endswith(FINE)]


def _find_ratios(rows: Sequence[Row]) -> list[float]:
    """Ratios of fine to coarse parts of the mesh, of all rows that measured both."""
    return [row.values["mesh"] / row.values["mesh_coarse"] for row in rows if row.method.endswith(FINE)]


@lru_cache(maxsize=4)
def _solve_both(study: Split, effect: str, level: int, text: str) -> tuple[Floats, Floats]:
    """Skins [mm] of an expression by the law with linear and with quadratic tets, each on its own settled face."""
    face, weights = study.person(level).face(EFFECTS[effect]), parse_weights(text)
    linear = m.METHODS[m.FENICSX_NEO_HOOKEAN].bind(face)
    solved = linear.solve(weights)
    law = linear.settled.law
    quadratic = face.settled_as(_settle_by_quadratic_tets(face, linear.settled))
    positions = _solve_fem(quadratic.scene(weights, law), solved.positions, QUADRATIC)
    return solved.skin, quadratic.skin_after(weights, positions, law)


def _settle_by_quadratic_tets(face: Face, linear: SettledFace) -> SettledFace:
    """Settle a neutral face by the law with quadratic tets, from where linear ones settled it."""
    settled = settle(
        face.head,
        face.on_wraps,
        law=linear.law,
        solver="fenicsx",
        element="P2",
        start=linear.positions,
        tolerance=QUADRATIC_NEUTRAL,
        **face.choices,
    )
    if not settled.converged:
        raise SoftdecaError(f"FEniCSx: {settled.reason}")
    return settled


def _solve_fem(scene: Scene, start: Floats, tolerance: float) -> Floats:
    how = {"solver": "fenicsx", "start": start, "tolerance": tolerance, "element": "P2"}
    return solve_to_end(scene, "FEniCSx", **how).positions


def _measure_mean(a: Floats, b: Floats) -> float:
    return float(distances(a, b).mean())
