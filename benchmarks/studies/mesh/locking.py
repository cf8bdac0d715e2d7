"""How much linear tets lock on a head, by Poisson's ratio and sub-layers, and what the split of prisms adds.

The reference is the same law by quadratic tets on the head's own mesh, from a Poisson's ratio of .49 with a linear
pressure (Taylor-Hood). Free tets by gmsh between the same wraps share no edge inside with the split prisms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.limits import LEVEL
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.head.head import LayeredHead
from ....lhm.head.remesh import remesh
from ....lhm.template.template import DEFAULT_LEVEL
from ....reference import Scene
from ....surrogate.ruler import measure
from ...harness.study import Column, Row, Table, Task, Values, above, at_most
from ..measures import distances, solve_to_end
from ..person import OfPerson, Person, parse_poisson, person
from ..scaling.mixed import make_law_scene

PRISMS, FREE, MIRRORED = "split prisms", "free tets (gmsh)", "mirrored loads"
MEAN = ", mean head"
SUB_LAYERS = (1, 2, 4)
FINER_LAYERS = (1, 2)
"""Sub-layers on a level above the study's own, where four take a minute."""
MOST = 0.4999
"""Bound of Poisson's ratio, above which quadratic tets have no reference here."""
WITH_PRESSURE = 0.49
"""Poisson's ratio from which on the reference has a pressure."""
LINEAR_TOLERANCE, REFERENCE_TOLERANCE, MIXED_TOLERANCE = 1e-7, 2e-3, 1e-6
"""Gradient norm over its start. Quadratic tets start at the linear answer, where .002 leaves the skin 0.0001 mm."""
ONE_SIDED = "mouthSmileLeft*0.6"
"""Expression that is mirrored."""
PAIRED = 1e-3
"""Distance [mm] within which a mirrored skin vertex meets its partner."""
LOCKS = 6.3
"""Least growth of linear tets' error, over the motion, from the lowest to the highest Poisson's ratio.

Measured on level 1 from nu 0.38 to 0.499: 7.8.
"""
TWO_MESHES = 0.08
"""Bound of quadratic tets' distance between the two meshes, over that of linear to quadratic tets on one mesh.

Measured on level 1, nu 0.45: 0.066; linear tets in their place, 0.38.
"""


@dataclass(frozen=True)
class Locking(OfPerson):
    """Linear tets of one expression by Poisson's ratio and sub-layers; free tets; mirrored loads on the mean head."""

    name = "locking"
    question = (
        "How far are linear tets on a head from quadratic ones as tissue nears incompressibility, do sub-layers help, "
        "and what does the split of prisms add?"
    )
    columns = (
        Column("what", "mesh"),
        Column("tets", "tets"),
        Column("mean", "distance, mean [mm]"),
        Column("max", "max [mm]"),
        Column("over_all", "mean over mean |T - carried(S)|"),
        Column("share", "the same where the skin moves"),
        Column("iterations", "iterations", cost=True),
    )
    note = (
        "Neo-Hookean tissue of default shear moduli with prescribed bones, on the skin. The reference is quadratic "
        "tets on the same mesh: by displacement (P2) below nu 0.49, with a pressure (P2-P1) from there. Split prisms "
        "are compared with the reference, free tets with split prisms of the same element. T is the reference's skin; "
        "no bone is scaled, so carried(S) is S. Mirrored loads are a one-sided smile and its mirror image on the mean "
        "head, whose skin is symmetric but whose wraps are not. Their distance is that of one answer to the other's "
        "mirror image."
    )
    limit = 7200.0

    level: int = option(1, "of the template: 1,212, 4,842 or 19,362 vertices", bound=LEVEL)
    expression: str = option("mouthPucker", "as jawOpen*0.5+cheekPuff")
    poisson: tuple[str, ...] = option(
        ("0.38", "0.45", "0.47", "0.49", "0.499"), "a Poisson's ratio; repeat for several"
    )
    finer: tuple[str, ...] = option(("0.45",), f"a Poisson's ratio, also on level {DEFAULT_LEVEL}; repeat for several")
    free: tuple[str, ...] = option(("0.45",), "a Poisson's ratio, also on free tets by gmsh; repeat for several")
    size: float = option(8.0, "largest free tets inside [mm]")

    def tasks(self) -> Sequence[Task]:
        """Name each mesh by each Poisson's ratio. Raises InputError for options out of range."""
        self.check([self.expression])
        for text in (*self.poisson, *self.finer, *self.free):
            parse_poisson(text, MOST)
        if not np.isfinite(self.size) or self.size <= 0.0:
            raise InputError(f"size: expected a length above 0 mm, got {self.size:g}")
        levels = [(self.level, text) for text in self.poisson] + [(DEFAULT_LEVEL, text) for text in self.finer]
        return [
            *(Task(_name_case(level, text), PRISMS) for level, text in dict.fromkeys(levels)),
            *(Task(_name_case(self.level, text), FREE) for text in self.free),
            *(Task(f"level {level}{MEAN}", MIRRORED) for level in dict.fromkeys((self.level, DEFAULT_LEVEL))),
        ]

    def measure(self, task: Task) -> Values:
        """Solve one case on its meshes; each answer is one of `rows`."""
        if task.method == MIRRORED:
            return {"rows": self._solve_mirrored(int(task.case.removeprefix("level ").removesuffix(MEAN)))}
        level, text = _read_case(task.case)
        problem = _pose(self, level, float(text))
        if task.method == FREE:
            return {"rows": problem.on_free_tets(self.size)}
        return {"rows": problem.on_prisms(SUB_LAYERS if level == self.level else FINER_LAYERS)}

    def mean_person(self, level: int) -> Person:
        """Make the mean head, whose skin is its own mirror image."""
        return person(self.identities, None, level)

    def _solve_mirrored(self, level: int) -> list[dict]:
        of = self.mean_person(level)
        rest = of.head.skin.vertices
        moved = of.shape(ONE_SIDED) - rest
        distance, partner = cKDTree(rest).query(rest * MIRROR)
        if distance.max() > PAIRED:
            raise SoftdecaError(f"the mean skin is not symmetric: {distance.max():.3g} mm off its mirror image")
        rows = []
        for what, head in ((PRISMS, of.head), (FREE, remesh(of.head, self.size))):
            shapes = [rest + moved, rest + moved[partner] * MIRROR]
            answers = [_solve_linear(head, shape, 0.45) for shape in shapes]
            left, right = (answer["skin"] for answer in answers)
            motion = distances(right, shapes[1])
            rows.append(_compare(what, left[partner] * MIRROR, right, motion, answers[0]))
        return rows

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that linear tets lock, and that quadratic tets on two independent meshes are a reference for them."""
        prisms = {_read_case(row.case): row.values["rows"] for row in rows if row.method == PRISMS}
        at_level = {float(text): lines for (level, text), lines in prisms.items() if level == self.level}
        gates = []
        if len(at_level) > 1:
            low, high = (at_level[nu][0]["over_all"] for nu in (min(at_level), max(at_level)))
            gates.append(
                above("error of linear tets over the motion, highest over lowest Poisson's ratio", high / low, LOCKS)
            )
        apart = [
            row.values["rows"][1]["mean"] / at_level[float(text)][0]["mean"]
            for row in rows
            if row.method == FREE and float(text := _read_case(row.case)[1]) in at_level
        ]
        if apart:
            what = "quadratic tets on two independent meshes, over linear to quadratic tets, worst"
            gates.append(at_most(what, max(apart), TWO_MESHES))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the error by Poisson's ratio, the free tets' distance, and the asymmetry of both meshes."""
        sentences = [
            f"{row.case}: linear tets are {lines[0]['mean']:.3f} mm from quadratic ones on average, "
            f"{lines[0]['max']:.2f} mm at most, {lines[0]['over_all']:.1f} times |T - carried(S)|."
            for row in rows
            if row.method == PRISMS and (lines := row.values["rows"])
        ]
        for row in rows:
            if row.method == FREE:
                parts = ", ".join(f"{line['what']} {line['mean']:.4f} mm" for line in row.values["rows"])
                sentences.append(f"{row.case}, free tets to split prisms: {parts}.")
            if row.method == MIRRORED:
                parts = ", ".join(f"{line['what']} {100.0 * line['over_all']:.1f} %" for line in row.values["rows"])
                sentences.append(f"{row.case}: mirrored loads differ, of |T - S|, by {parts}.")
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Lay out the error of linear tets: a line per Poisson's ratio, a column per number of sub-layers."""
        lines = []
        for row in rows:
            if row.method == PRISMS:
                answers = row.values["rows"]
                figures = [f"{line['mean']:.4f} / {line['max']:.3f} / {line['over_all']:.2f}" for line in answers]
                figures += [""] * (len(SUB_LAYERS) - len(answers))
                lines.append((row.case, answers[0]["reference"], *figures))
        titles = ["case", "reference", *(_name_layers(count) for count in SUB_LAYERS)]
        caption = "Linear tets to the reference: mean [mm] / max [mm] / times mean |T - carried(S)|"
        return [Table(caption, titles, lines)] if lines else []

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the mean error against Poisson's ratio, a line per number of sub-layers."""
        prisms = [(_read_case(row.case), row.values["rows"]) for row in rows if row.method == PRISMS]
        if not prisms:
            return {}
        figure, axes = subplots(1, 2, figsize=(8.8, 3.4))
        for axis, key, what in zip(
            axes, ("mean", "over_all"), ("mean error [mm]", "mean error / mean |T - carried(S)|"), strict=True
        ):
            for number, count in enumerate(SUB_LAYERS):
                for level, style in ((self.level, "o-"), (DEFAULT_LEVEL, "s:")):
                    points = sorted(
                        (float(text), lines[number][key])
                        for (of, text), lines in prisms
                        if of == level and number < len(lines)
                    )
                    if points and not (level == DEFAULT_LEVEL == self.level and style == "s:"):
                        label = f"{_name_layers(count)}, level {level}"
                        from_half, sizes = [0.5 - nu for nu, _ in points], [size for _, size in points]
                        axis.plot(from_half, sizes, style, color=f"C{number}", ms=4, label=label)
            axis.set(xlabel="Poisson's ratio", ylabel=what, xscale="log")
            shown = sorted({text for (_, text), _ in prisms}, key=float)
            axis.set_xticks([0.5 - float(text) for text in shown], shown, fontsize=8)
            axis.minorticks_off()
            axis.set_ylim(bottom=0.0)
            axis.invert_xaxis()
        axes[0].legend(fontsize=8)
        return {"Distance of linear to quadratic tets by Poisson's ratio.": to_svg(figure)}


MIRROR = np.array([-1.0, 1.0, 1.0])


class _Problem:
    """One expression by one law on a level's head, and what this process has solved of it."""

    def __init__(self, head: LayeredHead, shape: Floats, poisson: float):
        self.head, self.shape, self.poisson = head, shape, poisson
        self.element = "P2P1" if poisson >= WITH_PRESSURE else "P2"
        self.linear = _solve_linear(head, shape, poisson)
        self.quadratic = _solve_quadratic(head, shape, poisson, self.element, self.linear)
        self.motion = distances(self.quadratic["skin"], shape)

    def on_prisms(self, counts: Sequence[int]) -> list[dict]:
        """Compare linear tets with the reference; `counts` of sub-layers begin with one."""
        answers = {1: self.linear}
        for count in counts[1:]:
            answers[count] = _solve_linear(self.head, self.shape, self.poisson, (count, count))
        of_reference = {"reference": self.element, "reference_iterations": self.quadratic["iterations"]}
        reference = self.quadratic["skin"]
        return [
            _compare(f"P1, {_name_layers(count)}", answer["skin"], reference, self.motion, answer) | of_reference
            for count, answer in answers.items()
        ]

    def on_free_tets(self, size: float) -> list[dict]:
        """Compare free tets with split prisms, element by element."""
        free = remesh(self.head, size)
        linear = _solve_linear(free, self.shape, self.poisson)
        quadratic = _solve_quadratic(free, self.shape, self.poisson, self.element, linear)
        pairs = (("P1", linear, self.linear), (self.element, quadratic, self.quadratic))
        return [_compare(what, a["skin"], b["skin"], self.motion, a) for what, a, b in pairs]


@lru_cache(maxsize=2)
def _pose(study: Locking, level: int, poisson: float) -> _Problem:
    of = study.person(level)
    return _Problem(of.head, of.shape(study.expression), poisson)


def _solve_linear(head: LayeredHead, shape: Floats, poisson: float, layers: tuple[int, int] = (1, 1)) -> dict:
    scene = make_law_scene(head, shape, poisson, layers)
    return _solve(head, shape, scene, tolerance=LINEAR_TOLERANCE)


def _solve_quadratic(head: LayeredHead, shape: Floats, poisson: float, element: str, near: dict) -> dict:
    scene = make_law_scene(head, shape, poisson)
    if element == "P2":
        return _solve(head, shape, scene, element=element, start=near["positions"], tolerance=REFERENCE_TOLERANCE)
    return _solve(head, shape, scene, element=element, tolerance=MIXED_TOLERANCE)


def _solve(head: LayeredHead, shape: Floats, scene: Scene, **options: Any) -> dict:
    """Solve; give positions, skin [mm], iterations and the number of tets. Raises SoftdecaError if it stalls."""
    solution = solve_to_end(scene, options.get("element", "P1"), solver="fenicsx", **options)
    return {
        "positions": solution.positions,
        "skin": head.skin_after(shape, solution.positions[: len(head.bone)]),
        "iterations": solution.iterations,
        "tets": len(scene.tets),
    }


def _compare(what: str, skin: Floats, reference: Floats, motion: Floats, answer: dict) -> dict:
    away = distances(skin, reference)
    ruler = asdict(measure(away, motion))
    # Where nothing moves there is no share.
    share = {"share": ruler["share"], "moving": ruler["vertices"]} if ruler["vertices"] else {"moving": 0}
    return {
        "what": what,
        "tets": answer["tets"],
        "iterations": answer["iterations"],
        "mean": float(away.mean()),
        "max": float(away.max()),
        "over_all": float(away.mean() / motion.mean()),
        "moved": float(motion.mean()),
        **share,
    }


def _name_case(level: int, text: str) -> str:
    return f"level {level}, nu {text}"


def _read_case(case: str) -> tuple[int, str]:
    level, _, text = case.partition(", nu ")
    return int(level.removeprefix("level ")), text


def _name_layers(count: int) -> str:
    return f"{count} sub-layer{'s' * (count > 1)}"
