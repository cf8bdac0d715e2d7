"""Where a frame's error comes from: the network, the corpus' tolerance, PD's energy as a law, and the mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....lhm.expressions import parse_weights
from ....lhm.template.template import DEFAULT_LEVEL
from ....reference import Parameters
from ....surrogate import methods as m
from ....surrogate.methods import Method
from ...contest import Case, Contest, collect_rows, list_columns, list_failures, summarise
from ...harness.first_screen import find_losses
from ...harness.study import Row, Table, at_most
from ..agreement.solvers import FENICSX_FROM_PD, FROM_PD
from ..person import OfPerson, check_known

EFFECTS: Mapping[str, Parameters] = {
    "defaults": Parameters(),
    "40 % more soft tissue": Parameters(soft_volume=1.4),
    "skin grown by 30 %": Parameters(skin_growth=1.3),
    "softer, 2 g": Parameters(soft_stiffness=2.0, gravity=2.0),
}
PARTS = {
    "network": (m.NETWORK, m.PD_AS_TRAINED),
    "tolerance": (m.PD_AS_TRAINED, m.PD),
    "law": (m.PD, m.FENICSX_NEO_HOOKEAN),
    "mesh": (m.PD, m.FENICSX_P2),
}
"""Two methods, whose mean distance over the skin is the part. Each settles the neutral face by itself."""
QUADRATIC = ", first expression by quadratic tets"
RIVALS = (m.SETTLED, m.CARRIED, m.DERIVATIVES)
SHARES: Mapping[str, float] = {"defaults": 0.25, "softer, 2 g": 0.2}
"""Bound of the network's share by effect, below both rivals' shares. Effects in which it loses to one have none."""
TOLERANCE, SAME = 0.1, 1e-3
"""Bounds of the corpus' tolerance over the network's error, and of what two solvers of one energy differ by [mm]."""


@dataclass(frozen=True)
class Split(OfPerson, Contest):
    """The error of the shipped network on a person it has not seen, part by part; effects by expressions."""

    name = "split"
    version = 5
    question = "Where does the network's error come from?"
    needs = ("people", "heads", "network")
    cheap = "defaults"
    truths: ClassVar[tuple[str, ...]] = (m.PD, m.PD_AS_TRAINED, m.FENICSX_NEO_HOOKEAN)
    columns = list_columns((*truths, m.FENICSX_P2), ("share", "everywhere"))
    note = Contest.note + (
        " A part is the mean distance over the skin of two methods, each of which settles the neutral face by itself. "
        "The part of the mesh is measured on some frames."
    )

    expressions: tuple[str, ...] = option(
        ("jawOpen*0.5", "mouthSmileLeft*0.6+mouthSmileRight*0.6", "mouthPucker", "cheekPuff"),
        "as jawOpen*0.5+cheekPuff; repeat for several",
    )
    effects: tuple[str, ...] = option(tuple(EFFECTS), f"one of {', '.join(EFFECTS)}; repeat for several")
    seed: int = 1_000_003
    refined: tuple[str, ...] = option(
        ("defaults", "40 % more soft tissue"), "an effect with quadratic tets, first expression: minutes each"
    )
    level: int = DEFAULT_LEVEL

    def list_cases(self) -> Sequence[str]:
        """Name each effect, and those with quadratic tets."""
        self.check(self.expressions)
        check_known("effect", (*self.effects, *self.refined), EFFECTS)
        if not self.expressions:
            raise InputError("expressions: there is none")
        return [*self.effects, *(name + QUADRATIC for name in self.refined)]

    def make_case(self, name: str) -> Case:
        """Make the person's face under an effect, with the expressions."""
        effect, someone = name.removesuffix(QUADRATIC), self.person()
        chosen = self.expressions[:1] if name.endswith(QUADRATIC) else self.expressions
        return Case(
            name,
            effect,
            lambda: someone.face(EFFECTS[effect]),
            np.stack([parse_weights(text) for text in chosen]),
            someone.fit_s,
        )

    def list_methods(self, name: str) -> Sequence[str | Method]:
        """List the network, its rivals and FEniCSx from PD's answer, since energy may have two minima.

        Beside quadratic tets PD alone.
        """
        return () if name.endswith(QUADRATIC) else (m.NETWORK, *RIVALS, FROM_PD)

    def list_truths(self, name: str) -> Sequence[str]:
        """List those whose differences are parts."""
        return (m.PD, m.FENICSX_P2) if name.endswith(QUADRATIC) else self.truths

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that the reference holds, that the corpus is exact enough, and that the network beats its rivals."""
        lines = collect_rows(rows)
        gates = [at_most("frames that a method could not make", len(list_failures(lines)), 0)]
        found = summarise(lines, "method", m.PD)
        if FENICSX_FROM_PD in found:
            same = "PD to FEniCSx from its answer, same energy, largest distance of the skin [mm]"
            gates.append(at_most(same, found[FENICSX_FROM_PD].farthest, SAME))
        parts = _measure_parts(lines)
        if {"tolerance", "network"} <= parts.keys():
            share = parts["tolerance"] / parts["network"]
            gates.append(at_most("the corpus' tolerance over the network's error", share, TOLERANCE))
        shares = summarise([line for line in lines if line["method"] == m.NETWORK], "case", m.PD)
        return gates + [
            at_most(f"network's share of |T - carried(S)|, {effect}", shares[effect].share, bound)
            for effect, bound in SHARES.items()
            if effect in shares
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell each part's mean, which is the largest, and where a rival without learning beats the network."""
        lines = collect_rows(rows)
        parts, moved = _measure_parts(lines), summarise(lines, "method", m.PD).get(m.CARRIED)
        if moved is None or not parts:
            return ""
        motion = moved.everywhere
        told = ", ".join(
            f"{' - '.join(PARTS[key])} {mean:.3f} mm ({100.0 * mean / motion:.1f} %)" for key, mean in parts.items()
        )
        largest = " - ".join(PARTS[max(parts, key=lambda key: parts[key])])
        lost = [f"{effect}: the network loses to {rival}." for effect, rival, _, _ in find_losses(lines, "case", m.PD)]
        return " ".join(
            [f"Simulation moves the skin by {motion:.2f} mm on average beyond what bones carry. Parts: {told}.",
             f"Most is {largest}.", *lost]
        )  # fmt: skip

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate parts [mm], and shares of methods, by effect."""
        lines = collect_rows(rows)
        body, shares = [], []
        for effect in dict.fromkeys(line["kind"] for line in lines):
            own = [line for line in lines if line["kind"] == effect]
            parts, found = _measure_parts(own), summarise(own, "method", m.PD)
            body.append((effect, *(parts.get(key) for key in PARTS)))
            shares.append((effect, *(found[name].share if name in found else None for name in (m.NETWORK, *RIVALS))))
        titles = ["effect", *(" - ".join(pair) for pair in PARTS.values())]
        return [
            Table("Parts of the error, mean over the skin [mm]", titles, body),
            Table("Share of |T - carried(S)| that methods leave", ["effect", m.NETWORK, *RIVALS], shares),
        ]


def _measure_parts(lines: Sequence[Mapping]) -> dict[str, float]:
    """Measure the mean distance of each part over the frames that have it."""
    found = {key: summarise(lines, "method", truth).get(name) for key, (name, truth) in PARTS.items()}
    return {key: each.everywhere for key, each in found.items() if each is not None}
