"""What each piece of the facial scene costs, what the face is wrong by without it, and the smallest that will do."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import SoftdecaError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference import Face, Parameters, smallest_facial_scene
from ....reference.face.minimal import FACIAL_PIECES, TOLERANCE, choose, solve_skin
from ....reference.face.tissue import bone_points
from ...harness.study import Column, Row, Task, Values, at_least, at_most
from ..measures import COUNTS, ENDED, MEMORY, TIMES, Stopwatch, distances, measure_megabytes, time_solve
from ..person import OfPerson, check_known

EFFECTS: Mapping[str, Parameters] = {
    "20 % more soft tissue": Parameters(soft_volume=1.2),
    "3 g": Parameters(gravity=3.0),
}
SMILE = "mouthSmileLeft*0.6+mouthSmileRight*0.6+jawOpen*0.2"
WHOLE, SMALLEST = "whole scene", "smallest scene"

Change = Callable[[Face], Face]
ADDED: Mapping[str, Change] = {
    "with contact of lips and lids": lambda face: choose(face, contact=("lips", "lids")),
    "with soft bones (Eq. 13)": lambda face: choose(face, bones="soft"),
    "with connecting tets to the skull": lambda face: choose(face, attached=bone_points(face.head)),
}
LEFT_OUT: Mapping[str, Change] = {
    f"without {piece}": change for piece, change in FACIAL_PIECES.items() if piece != "contact"
}
ADDED_GRAVITY = "without gravity beyond the scan's"
"""Only of a case that has some."""


@dataclass(frozen=True)
class Minimal(OfPerson):
    """Three expressions and two effects, the whole scene and each with a piece more or less."""

    name = "minimal"
    heading = "What can a scene leave out?"
    question = "What does each term, layer, region and contact cost, and how wrong is the face without it?"
    cheap = "mouthPucker+cheekPuff*0.5, without membrane of the skin"
    columns = (
        Column("tets", "tets"),
        Column("settle_s", "settle, processor time [s]", cost=True),
        *TIMES[:-1],
        Column("cpu_s", "processor time of all [s]", cost=True),
        *COUNTS,
        MEMORY,
        Column("mean_mm", "changes the skin, mean [mm]"),
        Column("max_mm", "max [mm]"),
        Column("without", "left out"),
        ENDED,
    )
    note = (
        "Projective dynamics solves from rest to a gradient norm of 1e-6 of its start, in its own process. Memory is "
        "beside head and libraries. Under an effect the neutral face settles first, by the same scene as the "
        "expression. The change is the distance of the skin's vertices to those of the whole scene. The whole scene "
        "has three wraps, membrane, rigid cranium and mandible. `reference.smallest_facial_scene` chooses the "
        "smallest."
    )
    timed = True
    alone = True
    version = 2
    needed: ClassVar[float] = 0.8
    """[mm] 3 g moves the settled face by 1 mm; a study that lets targets hold the face finds .02."""

    expressions: tuple[str, ...] = option(
        (
            "jawOpen*0.7+mouthSmileLeft+mouthSmileRight",
            "mouthPressLeft+mouthPressRight+mouthRollLower+mouthRollUpper+eyeBlinkLeft+eyeBlinkRight",
            "mouthPucker+cheekPuff*0.5",
        ),
        "as jawOpen*0.5+cheekPuff; repeat for several",
    )
    effects: tuple[str, ...] = option(tuple(EFFECTS), f"one of {', '.join(EFFECTS)}; repeat for several")
    within: float = option(0.1, "mm that the smallest scene may change a vertex of the skin")

    def tasks(self) -> Sequence[Task]:
        """List each scene whole, with a piece more or less, and smallest."""
        self.check(self.expressions)
        check_known("effect", self.effects, EFFECTS)
        methods = (WHOLE, *LEFT_OUT, *ADDED, SMALLEST)
        heavy = {name for name in self.effects if EFFECTS[name].added_gravity.any()}
        pairs = [(case, method) for case in (*self.expressions, *self.effects) for method in methods]
        return [Task(case, method) for case, method in pairs if method != ADDED_GRAVITY or case in heavy]

    def measure(self, task: Task) -> Values:
        """Measure costs, and the change from the whole."""
        whole, expression = self.face(task.case), self.expression(task.case)
        if task.method == SMALLEST:
            smallest = smallest_facial_scene(whole, expression, within=self.within)
            return _measure_costs(smallest.model, whole, expression) | {
                "without": list(smallest.without),
                "alone_mm": dict(smallest.changes),
            }
        change = {**LEFT_OUT, **ADDED}.get(task.method)
        return _measure_costs(whole if change is None else change(whole), whole, expression)

    def face(self, case: str) -> Face:
        """Make the face of a case, whose scenes are whole."""
        parameters = EFFECTS.get(case, Parameters())
        choices, settling = {"bones": "rigid"}, {"tolerance": TOLERANCE}
        return Face(self.person().head, parameters=parameters, choices=choices, settling=settling)

    def expression(self, case: str) -> Floats:
        """Give the skin [mm], shape (n, 3), of a case's expression: a smile under an effect."""
        return self.person().shape(SMILE if case in EFFECTS else case)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all can be compared, and the smallest scene is as near as it has to be."""
        unfinished = sum(not row.values["converged"] for row in rows)
        chosen = [row.values["max_mm"] for row in rows if row.method == SMALLEST]
        gates = [at_most("scenes that did not reach what was asked", unfinished, 0)]
        gates += [at_most("change by the smallest scene [mm]", max(chosen), self.within)] if chosen else []
        floating = [row.values["max_mm"] for row in rows if row.method == ADDED_GRAVITY]
        what = "change of the skin where a face under more gravity goes without it, largest [mm]"
        return gates + ([at_least(what, min(floating), self.needed)] if floating else [])

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what may go, and what it saves."""
        sentences = []
        for row in rows:
            if row.method == SMALLEST:
                whole = _find_cost(rows, row.case, WHOLE)
                gone = ", ".join(row.values["without"]) or "nothing"
                saved = f" ({row.values['cpu_s'] / whole:.0%} of the time)" if whole else ""
                sentences.append(f"{row.case} does without {gone}{saved}")
        return f"Within {self.within:g} mm: {'; '.join(sentences)}." if sentences else ""

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the change by each piece against what it costs, a mark per scene."""
        figure, axis = subplots(figsize=(9, 4.6))
        for method in (*LEFT_OUT, *ADDED):
            points = [
                (_find_cost(rows, row.case, method) / whole, row.values["max_mm"])
                for row in rows
                if row.method == method and row.values["max_mm"] > 0 and (whole := _find_cost(rows, row.case, WHOLE))
            ]
            if points:
                axis.plot(*zip(*points, strict=True), "o", label=method)
        axis.axhline(self.within, color="#bbbbbb", lw=0.8, ls=":")
        axis.set(xlabel="processor time over the whole scene's", ylabel="largest change of the skin [mm]", yscale="log")
        if not axis.lines[1:]:
            return {}
        figure.legend(loc="outside right upper")
        return {"What a piece changes, against the time with or without it. Dotted: what is allowed.": to_svg(figure)}


def _find_cost(rows: Sequence[Row], case: str, method: str) -> float:
    return next((row.values["cpu_s"] for row in rows if (row.case, row.method) == (case, method)), 0.0)


def _measure_costs(model: Face, whole: Face, expression: Floats) -> dict:
    scene_mb = measure_megabytes(lambda: replace(model).expression_scene(expression))
    watch = Stopwatch()
    face = replace(model)  # one that has not settled yet
    settled = face.settled()
    if not settled.converged:
        raise SoftdecaError(f"the neutral face: {settled.reason}")
    _, settle_cpu = watch.lap()
    solution, costs = time_solve(lambda: face.expression_scene(expression), TOLERANCE)
    if not solution.converged:
        raise SoftdecaError(str(solution.reason))
    costs |= {"settle_s": settle_cpu, "cpu_s": costs["cpu_s"] + settle_cpu}
    apart = distances(face.expression_skin(expression, solution.positions), solve_skin(whole, expression))
    return {"tets": len(face.expression_scene(expression).tets), **costs, "scene_mb": scene_mb,
            "mean_mm": float(apart.mean()), "max_mm": float(apart.max())}  # fmt: skip
