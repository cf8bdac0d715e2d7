"""What each piece of the facial scene costs, and what the face is wrong by without it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ....lhm.base.errors import SoftdecaError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.head.head import LayeredHead
from ....reference import Face, Parameters, solve
from ....reference.face.tissue import bone_points
from ...harness.study import Column, Row, Task, Values, at_least, at_most
from ..measures import COUNTS, ENDED, TIMES, Stopwatch, distances, time_solve
from ..person import OfPerson, check_known

EFFECTS: Mapping[str, Parameters] = {
    "20 % more soft tissue": Parameters(soft_volume=1.2),
    "3 g": Parameters(gravity=3.0),
}
SMILE = "mouthSmileLeft*0.6+mouthSmileRight*0.6+jawOpen*0.2"
WHOLE = "whole scene"
ALLOWED = 0.1
"""[mm], below what one sees on a face."""
TOLERANCE = 1e-6
"""Gradient norm relative to its start, far below what the differences need."""

Change = Callable[[Face], Face]


def solve_skin(face: Face, expression: Floats) -> Floats:
    """Solve for a face's skin [mm], shape (n, 3), in an expression of the head without p, of the same shape.

    SoftdecaError where the neutral face or the expression does not come to rest.
    """
    settled = face.settled()
    if not settled.converged:
        raise SoftdecaError(f"the neutral face: {settled.reason}")
    solution = solve(face.expression_scene(expression), tolerance=TOLERANCE)
    if not solution.converged:
        raise SoftdecaError(str(solution.reason))
    return face.expression_skin(expression, solution.positions)


def choose(face: Face, **choices: Any) -> Face:
    """Return a face with other choices of `facial_scene`."""
    return replace(face, choices={**face.choices, **choices})


def change_parameters(face: Face, **values: Any) -> Face:
    """Return a face with other parameters."""
    return replace(face, parameters=replace(face.parameters, **values))


def lower_face(head: LayeredHead) -> np.ndarray:
    """Mask the face below the lids, shape (n,), of the wraps' vertices."""
    height = head.skin_wrap.vertices[:, 1]
    return head.regions["face"] & (height < height[head.regions["lids"]].min())


def _without(part: str) -> Change:
    return lambda face: choose(face, without=(*face.choices.get("without", ()), part))


ADDED: Mapping[str, Change] = {
    "with contact of lips and lids": lambda face: choose(face, contact=("lips", "lids")),
    "with soft bones (Eq. 13)": lambda face: choose(face, bones="soft"),
    "with connecting tets to the skull": lambda face: choose(face, attached=bone_points(face.head)),
}
LEFT_OUT: Mapping[str, Change] = {
    "without muscle layer": _without("muscle"),
    "without softness of muscle in strain": lambda face: change_parameters(face, muscle_strain_ratio=1.0),
    "without membrane of the skin": _without("skin"),
    "without tissue outside the face": lambda face: choose(face, region="face"),
    "without tissue outside the lower face": lambda face: choose(face, region=lower_face(face.head)),
    "without free rigid mandible": lambda face: choose(face, bones="prescribed"),
    "without gravity beyond the scan's": lambda face: change_parameters(
        face, gravity=1.0, gravity_x=0.0, gravity_y=-1.0, gravity_z=0.0
    ),
}
"""What a scene may do without: layers, terms, regions (others are carried along), motions of bone."""
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
        Column("mean_mm", "changes the skin, mean [mm]"),
        Column("max_mm", "max [mm]"),
        ENDED,
    )
    note = (
        "Projective dynamics solves from rest to a gradient norm of 1e-6 of its start. Under an effect the neutral "
        "face settles first, by the same scene as the expression. The change is the distance of the skin's vertices to "
        "those of the whole scene. The whole scene has three wraps, membrane, rigid cranium and mandible."
    )
    timed = True
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

    def tasks(self) -> Sequence[Task]:
        """List each scene whole, and with a piece more or less."""
        self.check(self.expressions)
        check_known("effect", self.effects, EFFECTS)
        methods = (WHOLE, *LEFT_OUT, *ADDED)
        heavy = {name for name in self.effects if EFFECTS[name].added_gravity.any()}
        pairs = [(case, method) for case in (*self.expressions, *self.effects) for method in methods]
        return [Task(case, method) for case, method in pairs if method != ADDED_GRAVITY or case in heavy]

    def measure(self, task: Task) -> Values:
        """Measure costs, and the change from the whole."""
        change = {**LEFT_OUT, **ADDED}.get(task.method, replace)
        return _measure_costs(change(self.face(task.case)), self.face(task.case), self.expression(task.case))

    def face(self, case: str) -> Face:
        """Make the face of a case, whose scenes are whole."""
        parameters = EFFECTS.get(case, Parameters())
        choices, settling = {"bones": "rigid"}, {"tolerance": TOLERANCE}
        return Face(self.person().head, parameters=parameters, choices=choices, settling=settling)

    def expression(self, case: str) -> Floats:
        """Give the skin [mm], shape (n, 3), of a case's expression: a smile under an effect."""
        return self.person().shape(SMILE if case in EFFECTS else case)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all can be compared, and that a face under more gravity needs it."""
        unfinished = sum(not row.values["converged"] for row in rows)
        gates = [at_most("scenes that did not reach what was asked", unfinished, 0)]
        floating = [row.values["max_mm"] for row in rows if row.method == ADDED_GRAVITY]
        what = "change of the skin where a face under more gravity goes without it, largest [mm]"
        return gates + ([at_least(what, min(floating), self.needed)] if floating else [])

    def words(self, rows: Sequence[Row]) -> str:
        """Tell which piece alone may go."""
        sentences = []
        for case in dict.fromkeys(row.case for row in rows):
            spare = [
                r.method for r in rows if r.case == case and r.method in LEFT_OUT and r.values["max_mm"] <= ALLOWED
            ]
            sentences.append(f"{case} {', or '.join(spare) or 'with all'}")
        return f"Within {ALLOWED:g} mm of the whole: {'; '.join(sentences)}."


def _measure_costs(model: Face, whole: Face, expression: Floats) -> dict:
    watch = Stopwatch()
    settled = model.settled()
    if not settled.converged:
        raise SoftdecaError(f"the neutral face: {settled.reason}")
    _, settle_cpu = watch.lap()
    solution, costs = time_solve(lambda: model.expression_scene(expression), TOLERANCE)
    if not solution.converged:
        raise SoftdecaError(str(solution.reason))
    costs |= {"settle_s": settle_cpu, "cpu_s": costs["cpu_s"] + settle_cpu}
    apart = distances(model.expression_skin(expression, solution.positions), solve_skin(whole, expression))
    tets = len(model.expression_scene(expression).tets)
    return {"tets": tets, **costs, "mean_mm": float(apart.mean()), "max_mm": float(apart.max())}
