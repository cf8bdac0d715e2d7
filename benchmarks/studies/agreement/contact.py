"""PD's contact of lips and lids: beside ipctk's barrier, and on hard frames of several people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....lhm.base.geometry.bvh import TriangleTree
from ....lhm.base.mesh import Floats
from ....lhm.expressions import parse_weights
from ....lhm.head.head import LayeredHead
from ....reference import Face, Parameters, prepare, terms
from ....surrogate import methods as m
from ....surrogate.methods import Method, Solved, SolvedRig, tell_solution
from ...contest import Case, Contest, Made, collect_rows, list_failures, run_contest
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import distances
from ..person import OfPerson

LIPS, LIDS = ("lips", "mouth"), ("lids", "eyes")
POSES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "lips pressed": ("mouthPressLeft+mouthPressRight", LIPS),
    "lower lip raised": ("mouthShrugLower", LIPS),
    "lids shut": ("eyeBlinkLeft+eyeBlinkRight", LIDS),
}
"""Expressions in which the regions beside them would go through each other."""
BLINK, SQUINT = "eyeBlinkLeft+eyeBlinkRight", "eyeSquintLeft+eyeSquintRight"
PRESS, SMILE = "mouthPressLeft+mouthPressRight", "mouthSmileLeft+mouthSmileRight"
ROLLS = "mouthRollLower+mouthRollUpper"
HARD: Mapping[str, str] = {
    "blink": BLINK,
    "blink, squint": f"{BLINK}+{SQUINT}",
    "blink, squint, cheeks": f"{BLINK}+{SQUINT}+cheekSquintLeft+cheekSquintRight",
    "blink of 0.8, squint": f"eyeBlinkLeft*0.8+eyeBlinkRight*0.8+{SQUINT}",
    "wink, squint": f"eyeBlinkLeft+{SQUINT}",
    "blink, brows down": f"{BLINK}+browDownLeft+browDownRight",
    "press": PRESS,
    "lower lip raised": "mouthShrugLower",
    "both lips raised": "mouthShrugLower+mouthShrugUpper",
    "close, jaw open": "mouthClose+jawOpen",
    "close of 0.6, jaw of 0.5": "mouthClose*0.6+jawOpen*0.5",
    "close": "mouthClose",
    "close of 0.3": "mouthClose*0.3",
    "pucker": "mouthPucker",
    "pucker, funnel": "mouthPucker+mouthFunnel",
    "pucker, press": f"mouthPucker+{PRESS}",
    "rolls": ROLLS,
    "lower roll, press": f"mouthRollLower+{PRESS}",
    "upper roll, lower lip raised": "mouthRollUpper+mouthShrugLower",
    "smile, press": f"{SMILE}+{PRESS}",
    "frown, lower lip raised": "mouthFrownLeft+mouthFrownRight+mouthShrugLower",
    "jaw forward, lower lip raised": "jawForward+mouthShrugLower",
    "mouth left, press": f"mouthLeft+{PRESS}",
    "blink, squint, press, lower lip raised": f"{BLINK}+{SQUINT}+{PRESS}+mouthShrugLower",
    "jaw of 0.3, rolls": f"jawOpen*0.3+{ROLLS}",
}
"""Expressions in which lips or lids meet, but for two of an open jaw, which cost what they do without contact."""
MADE_HARDER: Mapping[str, Parameters] = {
    "soft": Parameters(soft_stiffness=2.0),
    "3 g": Parameters(gravity=3.0),
    "more volume": Parameters(soft_volume=1.4, muscle_volume=1.3),
}
OTHERS = (1, 2, 3)
"""Seeds of other people, beside the study's own."""
AROUND = 5
"""Edges about the regions in contact, up to which tets are solved for: two more than contact reaches."""
STEPS = 4
"""Shares of the way to an expression's targets on which Newton's method meets the barrier little by little."""
ON_THE_WAY, TOLERANCE = 1e-2, 1e-6
"""Gradient norm relative to its start, before the last share and at the end."""
FREE, BARRIER, FROM_BARRIER = "PD, without contact", "ipctk's barrier", "PD, from the barrier's answer"
PRESSED, WHOLE = "poses", "hard frames"
"""Kinds of cases: the tets about the regions in contact, and the whole face."""
IN_CONTACT = m.solve_by(m.PD, "projective", "#1f77b4", tolerance=TOLERANCE)


@dataclass(frozen=True)
class Contact(Contest, OfPerson):
    """Lips pressed and lids shut by PD and by a barrier, and hard frames by PD with contact and without."""

    name = "contact"
    question = "Are lips and lids parted as another code parts them?"
    cheap = "press, soft"
    columns = (
        Column("method", "by"),
        Column("crossings", "pairs that cross"),
        Column("overlap", "overlap [mm]"),
        Column(f"{FREE}: rms", "to that without contact, RMS [mm]"),
        Column(f"{FREE}: max", "max [mm]"),
        Column(f"{BARRIER}: rms", "to the barrier, RMS [mm]"),
        Column(f"{BARRIER}: max", "max [mm]"),
        Column("frame_s", "frame [s]", cost=True),
        Column("iterations", "iterations", cost=True),
        Column("reason", "ended"),
    )
    note = (
        "One energy, PD's, on one mesh: the tets about lips or lids, beyond which the expression holds the face. PD "
        "keeps surfaces apart on its way from rest; scikit-fem minimises the energy with ipctk's barrier from rest on. "
        "PD starts at the barrier's answer too, and the nearer end counts: by prisms shut lids have two minima. "
        "Distances are over the surfaces in contact. Hard frames are of the whole face, by tets, from rest. Seconds "
        "are processor time of a frame of a prepared face."
    )
    version = 4

    def list_cases(self) -> Sequence[str]:
        """Name each pose, and the hard frames."""
        return [*POSES, *self._describe_hard()]

    def _describe_hard(self) -> Mapping[str, tuple[int, str, Parameters]]:
        """Give the seed, the expression and p of hard frames, by name."""
        own = {name: (self.seed, text, Parameters()) for name, text in HARD.items()}
        harder = {
            f"{name}, {how}": (self.seed, HARD[name], parameters)
            for how, parameters in MADE_HARDER.items()
            for name in ("blink, squint", "lower lip raised", "press")
        }
        others = {
            f"{name}, seed {seed}": (seed, HARD[name], Parameters())
            for seed in OTHERS
            for name in ("blink", "both lips raised", "close, jaw open")
        }
        return {f"{WHOLE}: {name}": described for name, described in (own | harder | others).items()}

    def make_case(self, name: str) -> Case:
        """Make the face about lips or lids, or the whole face of a hard frame."""
        if name in POSES:
            person, (text, regions) = self.person(), POSES[name]
            choices = {"region": _find_around(person.head, regions), "contact": regions}
            return Case(
                name, PRESSED, lambda: Face(person.head, person.shapes, choices=choices), parse_weights(text)[None]
            )
        seed, text, parameters = self._describe_hard()[name]
        person = self.person(seed=seed)
        return Case(name, WHOLE, lambda: _touch_by_tets(person.face(parameters)), parse_weights(text)[None])

    def list_methods(self, name: str) -> Sequence[Method]:
        """List nothing beside the truths; `measure` adds PD from the barrier's answer."""
        return []

    def list_truths(self, name: str) -> Sequence[Method]:
        """List PD without contact and in it, and of a pose the barrier."""
        free = Method(FREE, lambda face: IN_CONTACT.bind(_without_contact(face)))
        return [free, IN_CONTACT, *([Method(BARRIER, solve_by_barrier)] if name in POSES else ())]

    def warm(self) -> Case:
        """Blink on a coarse head."""
        person = self.person(level=1)
        return Case("uncounted", WHOLE, lambda: _touch_by_tets(person.face(Parameters())), parse_weights(BLINK)[None])

    def measure(self, task: Task) -> Values:
        """Run all methods: of a pose PD from the barrier's answer, too; of a hard frame also the price of contact."""
        if task.case not in POSES:
            values = super().measure(task)
            free, touching = (row["frame_s"] for row in values["rows"])
            return {**values, "times": touching / free if free and touching else None}
        made: dict[str, Made] = {}
        again = Method(FROM_BARRIER, lambda face: start_at(face, made[BARRIER].positions))
        case, truths = self.make_case(task.case), self.list_truths(task.case)
        return {"rows": run_contest(case, [again], truths, compare=self.compare, on_frame=made.__setitem__)}

    def compare(self, face: Face, weights: Floats, own: Made, true: Made) -> Mapping[str, Any]:
        """Measure how far a frame's surface in contact is from a truth's, and its pairs that cross."""
        (contact,) = face.scene(weights).of(terms.Contact)
        assert own.positions is not None and true.positions is not None
        apart = distances(own.positions, true.positions)[np.unique(contact.triangles)]
        crossings, overlap = TriangleTree(own.positions, contact.triangles).measure_overlap()
        rms = float(np.sqrt(np.mean(apart**2)))
        return {"crossings": crossings, "overlap": overlap, "rms": rms, "max": float(apart.max())}

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give a line for each method, with its own pairs that cross."""
        own = ("crossings", "overlap")
        return [
            {**line, **{key: to[key] for to in line["to"].values() for key in own if key in to}}
            for line in Contest.lines(values)
        ]

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all are solved, nothing crosses by PD in contact, and PD is near the barrier."""
        lines = collect_rows(rows)
        crossing = sum(to["crossings"] > 0 for to in _find(lines, m.PD, FREE).values())
        gates = [
            at_most("answers of PD that cross", crossing, 0),
            at_most("answers that have not converged", len(list_failures(lines)), 0),
        ]
        moved = _find(lines, FREE, BARRIER)
        shares = [apart / moved[case]["rms"] for case, apart in measure_apart(lines).items()]
        what = "RMS distance of PD's contact to the barrier, of what contact moves"
        return gates + ([at_most(what, max(shares), 0.05)] if shares else [])

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how far the codes are apart in each pose, and what contact does on hard frames."""
        lines = collect_rows(rows)
        moved = _find(lines, FREE, BARRIER)
        sentences = [
            f"{case}: contact moves the surface by {moved[case]['rms']:.2f} mm (RMS), PD and the barrier are "
            f"{apart:.4f} mm apart."
            for case, apart in measure_apart(lines).items()
        ]
        hard = [line for line in lines if line["kind"] == WHOLE]
        free, touching = _find(hard, FREE, m.PD), _find(hard, m.PD, FREE)
        if touching:
            times = {row.case: row.values["times"] for row in rows if "times" in row.values}
            crossing = [case for case, to in free.items() if to["crossings"] > 0]
            sentences.append(
                f"Of {len(touching)} hard frames {len(crossing)} cross without contact, and "
                f"{sum(to['crossings'] > 0 for to in touching.values())} with it, which moves a vertex by "
                f"{max(to['max'] for to in touching.values()):.1f} mm at most. Those frames cost "
                f"{np.median([times[case] for case in crossing or free]):.1f} times as much with it, in the median."
            )
        return " ".join(sentences)


def _find(lines: Sequence[Mapping], method: str, truth: str) -> dict[str, Mapping[str, Any]]:
    """Find how far a method is from a truth, by case."""
    return {line["case"]: line["to"][truth] for line in lines if line["method"] == method and truth in line["to"]}


def measure_apart(lines: Sequence[Mapping]) -> dict[str, float]:
    """Measure the RMS distance [mm] of PD to the barrier, by its nearer start."""
    from_rest, from_barrier = (_find(lines, method, BARRIER) for method in (m.PD, FROM_BARRIER))
    return {case: min(to["rms"], from_barrier.get(case, to)["rms"]) for case, to in from_rest.items()}


def _touch_by_tets(face: Face) -> Face:
    return replace(face, choices={"cells": "tets"}).in_contact()


def _without_contact(face: Face) -> Face:
    """Let surfaces go through each other, and through eyeballs and teeth."""
    return replace(face, choices={key: each for key, each in face.choices.items() if key not in ("contact", "organs")})


def solve_by_barrier(face: Face) -> SolvedRig:
    """Bind scikit-fem and ipctk, share by share of the motion from rest to the whole."""
    prepared = prepare(face.neutral_scene(), solver="skfem")

    def solve_frame(weights: Floats) -> Solved:
        positions = None
        for step in range(1, STEPS):
            positions = prepared.solve(
                face.scene(step / STEPS * weights), start=positions, tolerance=ON_THE_WAY
            ).positions
        return tell_solution(face, weights, prepared.solve(face.scene(weights), start=positions, tolerance=TOLERANCE))

    return SolvedRig(face.skin, solve_frame)


def start_at(face: Face, start: Floats | None) -> SolvedRig:
    """Bind PD, whose frames begin at positions (n, 3) [mm]."""
    prepared = prepare(face.neutral_scene())

    def solve_frame(weights: Floats) -> Solved:
        return tell_solution(face, weights, prepared.solve(face.scene(weights), start=start, tolerance=TOLERANCE))

    return SolvedRig(face.skin, solve_frame)


def _find_around(head: LayeredHead, regions: Sequence[str]) -> np.ndarray:
    """Mark the wraps' vertices within AROUND edges of some regions, shape (n,)."""
    triangles, inside = head.skin_wrap.triangles, np.any([head.regions[name] for name in regions], axis=0)
    for _ in range(AROUND):
        inside[triangles[inside[triangles].any(axis=1)]] = True
    return inside
