"""Cost of each piece of the facial scene, and the face's error without it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ....lhm.base.option import option
from ....lhm.expressions import parse_weights
from ....lhm.head.head import LayeredHead
from ....reference import Face, Parameters
from ....reference.face.tissue import bone_points
from ....surrogate import methods as m
from ....surrogate.methods import Method
from ...contest import Case, Contest, collect_rows, list_failures
from ...harness.study import Column, Row, Values, at_least, at_most
from ..person import OfPerson, check_known

EFFECTS: Mapping[str, Parameters] = {
    "20 % more soft tissue": Parameters(soft_volume=1.2),
    "3 g": Parameters(gravity=3.0),
}
SMILE = "mouthSmileLeft*0.6+mouthSmileRight*0.6+jawOpen*0.2"
WHOLE = "whole scene"
ALLOWED = 0.1
"""[mm], below what one sees on a face."""

Change = Callable[[Face], Face]


def choose(**choices: Any) -> Change:
    """Return what gives a face other choices of `facial_scene`."""
    return lambda face: replace(face, choices={**face.choices, **choices})


def change_parameters(**values: Any) -> Change:
    """Return what gives a face other parameters."""
    return lambda face: replace(face, parameters=replace(face.parameters, **values))


def lower_face(head: LayeredHead) -> np.ndarray:
    """Mask the face below the lids, shape (n,), of the wraps' vertices."""
    height = head.skin_wrap.vertices[:, 1]
    return head.regions["face"] & (height < height[head.regions["lids"]].min())


CHANGES: Mapping[str, Change] = {
    "without muscle layer": choose(without=("muscle",)),
    "without softness of muscle in strain": change_parameters(muscle_strain_ratio=1.0),
    "without membrane of the skin": choose(without=("skin",)),
    "without tissue outside the face": choose(region="face"),
    "without tissue outside the lower face": lambda face: choose(region=lower_face(face.head))(face),
    "without free rigid mandible": choose(bones="prescribed"),
    "without gravity beyond the scan's": change_parameters(gravity=1.0, gravity_x=0.0, gravity_y=-1.0, gravity_z=0.0),
    "with contact of lips and lids": choose(contact=("lips", "lids")),
    "with soft bones (Eq. 13)": choose(bones="soft"),
    "with connecting tets to the skull": lambda face: choose(attached=bone_points(face.head))(face),
}
"""Pieces that a scene may do without, layers, terms, regions (others are carried along) and motions of bone, or add."""
ADDED_GRAVITY = "without gravity beyond the scan's"
"""Only of a case that has some."""


def solve_changed(name: str, change: Change) -> Method:
    """Make a method that solves a changed face by PD, far below what the differences need."""
    by_pd = m.solve_by(name, "projective", "#000000", tolerance=1e-6)
    return replace(by_pd, bind=lambda face: by_pd.bind(change(face)))


@dataclass(frozen=True)
class Minimal(Contest, OfPerson):
    """Three expressions and two effects, the whole scene and each with a piece more or less."""

    name = "minimal"
    question = "What can a scene leave out?"
    cheap = "mouthPucker"
    columns = (
        Column("piece", "scene"),
        Column("bind_s", "neutral face and preparation [s]", cost=True),
        Column("frame_s", "frame [s]", cost=True),
        Column("iterations", "iterations", cost=True),
        Column("everywhere", "changes the skin, mean [mm]"),
        Column("farthest", "max [mm]"),
        Column("reason", "ended"),
    )
    note = (
        "Projective dynamics solves from the settled face to a gradient norm of 1e-6 of its start. The neutral face "
        "settles by the same scene as the expression. The change is the distance of the skin's vertices to those of "
        "the whole scene, which has three wraps, membrane, rigid cranium and mandible. Seconds are processor time."
    )
    version = 3
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

    def list_cases(self) -> Sequence[str]:
        """Name expressions and effects; InputError for an unknown one."""
        self.check(self.expressions)
        check_known("effect", self.effects, EFFECTS)
        return (*self.expressions, *self.effects)

    def make_case(self, name: str) -> Case:
        """Make an expression at default p, or a smile under an effect."""
        person, p = self.person(), EFFECTS.get(name, Parameters())
        weights = parse_weights(SMILE if name in EFFECTS else name)[None]
        kind = "effects" if name in EFFECTS else "expressions"
        return Case(name, kind, lambda: Face(person.head, person.shapes, p, choices={"bones": "rigid"}), weights)

    def list_methods(self, name: str) -> Sequence[Method]:
        """List each piece that may be left out, or added."""
        heavy = EFFECTS.get(name, Parameters()).added_gravity.any()
        return [solve_changed(piece, CHANGES[piece]) for piece in CHANGES if piece != ADDED_GRAVITY or heavy]

    def list_truths(self, name: str) -> Sequence[Method]:
        """List the whole scene."""
        return [solve_changed(WHOLE, lambda face: face)]

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give a line for each piece."""
        rows = values.get("rows", ())  # results of earlier versions have none
        return [{**row, "piece": row["method"], **row["told"], **row["to"].get(WHOLE, {})} for row in rows]

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all can be compared, and that a face under more gravity needs it."""
        lines = collect_rows(rows)
        gates = [at_most("scenes that did not reach what was asked", len(list_failures(lines)), 0)]
        floating = [line["to"][WHOLE]["farthest"] for line in lines if line["method"] == ADDED_GRAVITY]
        what = "change of the skin where a face under more gravity goes without it, largest [mm]"
        return gates + ([at_least(what, min(floating), self.needed)] if floating else [])

    def words(self, rows: Sequence[Row]) -> str:
        """Tell which piece alone may go."""
        spare: dict[str, list[str]] = {}
        for line in collect_rows(rows):
            may_go = line["method"].startswith("without") and WHOLE in line["to"]
            names = [line["method"]] if may_go and line["to"][WHOLE]["farthest"] <= ALLOWED else []
            spare.setdefault(line["case"], []).extend(names)
        parts = [f"{case} {', or '.join(names) or 'with all'}" for case, names in spare.items()]
        return f"Within {ALLOWED:g} mm of the whole: {'; '.join(parts)}."
