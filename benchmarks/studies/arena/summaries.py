"""Summaries of the arena's rows: times over problems of one kind, and claims of the literature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....surrogate import methods as m
from ...harness.study import Row, Table
from .laws import ISOCHORIC, NEO_HOOKEAN, PLAIN_STABLE, PROJECTIVE, RIGID, ST_VENANT
from .runs import ACCURACIES, HUNDREDTH, ONE, REST, TENTH

CASES_OF: Mapping[str, Mapping[str, str]] = {
    "Heads whose jaw is opened": {
        "14.5 k tets": "head's jaw opened, 14.5 k tets",
        "58 k tets": "head's jaw opened, 58 k tets",
    },
    "The face of an expression": {
        "without its membrane": "face posed without its membrane, 14.5 k tets",
        "by Eq. 15": "face posed by Eq. 15, 14.5 k tets",
    },
}
"""Problems of one kind by what differs."""
Side = tuple[str, str]
"""A solver, or several whose best counts, and the law that it solves."""


@dataclass(frozen=True)
class Claim:
    """One side is faster than another, from rest, to an accuracy (its number in ACCURACIES)."""

    words: str
    source: str
    one: Side
    other: Side
    accuracy: int


LIU = "Liu et al. 2017, Quasi-Newton methods for real-time simulation"
NEWTON = m.FENICSX, PROJECTIVE
CLAIMS = (
    Claim("Local and global steps of projective dynamics are faster than Newton, to 1 mm.",
          "Bouaziz et al. 2014, Projective dynamics", (m.PD_PLAIN, PROJECTIVE), NEWTON, ONE),
    Claim("They stay faster to 0.01 mm.", "the same, as it is often cited",
          (m.PD_PLAIN, PROJECTIVE), NEWTON, HUNDREDTH),
    Claim("L-BFGS over the same factor is faster than plain projective dynamics.", LIU,
          (m.PD, PROJECTIVE), (m.PD_PLAIN, PROJECTIVE), HUNDREDTH),
    Claim("L-BFGS over that factor is faster than Newton.", LIU, (m.PD, PROJECTIVE), NEWTON, HUNDREDTH),
    Claim("Anderson's acceleration makes projective dynamics faster.",
          "Peng et al. 2018, Anderson acceleration for geometry optimization",
          (m.PD_ANDERSON, PROJECTIVE), (m.PD_PLAIN, PROJECTIVE), HUNDREDTH),
    Claim("L-BFGS beats Anderson.", "common talk", (m.PD, PROJECTIVE), (m.PD_ANDERSON, PROJECTIVE), HUNDREDTH),
    Claim("L-BFGS beats local and global steps on the energy of as-rigid-as-possible deformation.", LIU,
          (m.PD, RIGID), ("libigl ARAP", RIGID), HUNDREDTH),
    Claim("L-BFGS on projective dynamics' energy arrives before Newton on the neo-Hookean law.", "common talk",
          (m.PD, PROJECTIVE), (m.FENICSX_NEO_HOOKEAN, NEO_HOOKEAN), HUNDREDTH),
    Claim("Vertex block descent is faster than Newton, to 0.1 mm, on a CPU.",
          "common talk; its paper compares on GPUs", ("Newton VBD", PLAIN_STABLE), (m.FENICSX, PLAIN_STABLE), TENTH),
    Claim("A simulator of robots, brought to rest, is as fast as finite elements, to 0.1 mm.", "common talk",
          ("MuJoCo flex", ST_VENANT), (m.FENICSX, ST_VENANT), TENTH),
    Claim("Multigrid and conjugate gradients beat a sparse direct solver in Newton.", "common talk",
          (m.FENICSX_NEO_HOOKEAN, NEO_HOOKEAN), (m.SKFEM_NEO_HOOKEAN, NEO_HOOKEAN), HUNDREDTH),
    *(
        Claim(f"Our Newton is faster than that of {title}.", "none", (m.FENICSX_NEO_HOOKEAN, NEO_HOOKEAN),
              (title, NEO_HOOKEAN), HUNDREDTH)
        for title in ("FElupe", "torch-fem", "JAX-FEM")
    ),
    Claim("Our Newton is faster than that of sfepy.", "none", (m.FENICSX, ISOCHORIC), ("sfepy", ISOCHORIC), HUNDREDTH),
)  # fmt: skip


def find_best(rows: Sequence[Row], solver: str, law: str, index: int) -> dict[str, float]:
    """Give the least time [s] with set-up of a solver's settings from rest to the accuracy of that number, by problem.

    inf where it was not reached.
    """
    best: dict[str, float] = {}
    for row in rows:
        values = row.values
        if (values["solver"], values["law"], values["start"]) == (solver, law, REST):
            reached = (values.get("seconds_to") or [None] * len(ACCURACIES))[index]
            seconds = np.inf if reached is None else values["set_up_s"] + reached
            best[row.case] = min(seconds, best.get(row.case, np.inf))
    return best


def judge_claims(rows: Sequence[Row]) -> Table:
    """Tabulate on how many problems each claim holds, of those that one of its sides solves."""
    lines = []
    for claim in CLAIMS:
        one, other = (find_best(rows, *side, claim.accuracy) for side in (claim.one, claim.other))
        pairs = [(one[case], other[case]) for case in one.keys() & other.keys()]
        judged = [mine < its for mine, its in pairs if min(mine, its) < np.inf]
        energies = dict.fromkeys((claim.one[1], claim.other[1]))
        energy = next(iter(energies)) if len(energies) == 1 else f"each its own: {', '.join(energies)}"
        if judged:
            lines.append((claim.words, claim.source, energy, f"{sum(judged)} of {len(judged)}"))
    return Table("Claims", ["claim", "source", "energy", "holds on"], lines)


def rank_solvers(rows: Sequence[Row]) -> list[str]:
    """Tell who was first to 0.01 mm on each problem, among solvers of one law."""
    times: dict[tuple[str, str], dict[str, float]] = {}
    for solver, law in dict.fromkeys((row.values["solver"], row.values["law"]) for row in rows):
        for case, seconds in find_best(rows, solver, law, HUNDREDTH).items():
            if seconds < np.inf:
                times.setdefault((case, law), {})[solver] = seconds
    sentences = []
    for (case, law), among in times.items():
        ranked = sorted(among.items(), key=lambda item: item[1])[:4]
        if len(ranked) > 1:
            sentences.append(f"{case}, {law}: {', '.join(f'{title} {seconds:.2g} s' for title, seconds in ranked)}")
    return sentences


def tabulate_best(rows: Sequence[Row], what: str, cases: Mapping[str, str]) -> Table:
    """Tabulate each solver's least time with set-up to 0.1 and 0.01 mm and its least error at the end, over settings.

    A solver has a line for each law. Solvers that solve none of the problems are left out.
    """
    lines = []
    there = {name: case for name, case in cases.items() if any(row.case == case for row in rows)}
    for solver, law in dict.fromkeys((row.values["solver"], row.values["law"]) for row in rows):
        own = [
            row for row in rows if (row.values["solver"], row.values["law"], row.values["start"]) == (solver, law, REST)
        ]
        times = [find_best(own, solver, law, accuracy) for accuracy in (TENTH, HUNDREDTH)]
        line: list = [solver, law]
        for case in there.values():
            ends = [row.values["max_mm"] for row in own if row.case == case and row.values["max_mm"] is not None]
            reached = [best.get(case, np.inf) for best in times]
            line += [*(seconds if seconds < np.inf else None for seconds in reached), min(ends, default=None)]
        if any(cell is not None for cell in line[2:]):
            lines.append(tuple(line))
    head = [f"{name}: {column}" for name in there for column in ("to 0.1 mm [s]", "to 0.01 mm [s]", "end [mm]")]
    return Table(f"{what}: time with set-up, best setting", ["solver", "law", *head], lines)


def tabulate_times(rows: Sequence[Row]) -> Table:
    """Tabulate each solver's processor time from rest to the accuracies."""
    none = [None] * len(ACCURACIES)
    lines = [
        (row.case, row.values["solver"], row.values["setting"], *(row.values.get("seconds_to") or none))
        for row in rows
        if row.values["start"] == REST
    ]
    head = ["problem", "solver", "setting", *(f"to {accuracy:g} mm [s]" for accuracy in ACCURACIES)]
    return Table("Processor time of the solve to an accuracy", head, lines)
