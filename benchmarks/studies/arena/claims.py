"""Claims of papers and of common talk, as data, and how the arena's rows judge each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....surrogate.methods import FENICSX, LIBIGL_ARAP, PD, PD_ANDERSON, PD_ARAP, PD_PLAIN
from ...harness.study import Row, Values
from .contest import ACCURACIES, ANSWER, HUNDREDTH, ONE, REST, TENTH, THOUSANDTH

Judged = tuple["Claim", str, str]
"""A claim, its verdict and its figures."""
Sides = Mapping[str, float | None]
"""By problem, a figure that is to be at most 1 where the claim holds; None where the claim's own side failed."""


@dataclass(frozen=True)
class Claim:
    """Words, where they stand, and what of the rows gives figures by problem: at most 1 where the claim holds."""

    words: str
    source: str
    figures: Callable[[Sequence[Row]], Sides]
    quantity: str
    """The name of the figures."""

    def judge(self, rows: Sequence[Row]) -> tuple[str, str]:
        """Give "holds", "holds where", "does not" or "not measured", and the figures as text."""
        sides = self.figures(rows)
        if not sides:
            return "not measured", ""
        holds = [case for case, figure in sides.items() if figure is not None and figure <= 1.0]
        verdict = "holds" if len(holds) == len(sides) else "holds where" if holds else "does not"
        texts = [f"{case}: {'not reached' if figure is None else f'{figure:.2g}'}" for case, figure in sides.items()]
        return verdict, f"{self.quantity}: " + "; ".join(texts)


def judge_all(rows: Sequence[Row]) -> list[Judged]:
    """Judge each claim by the rows of a run."""
    return [(claim, *claim.judge(rows)) for claim in CLAIMS]


def find_time(row: Row, index: int, *, prepared: bool = False) -> float | None:
    """Give set-up (its median) and solve [s] to the accuracy of that number; None where it was not reached.

    Without set-up where the solver is `prepared`.
    """
    reached = row.values.get("seconds_to")
    seconds: float | None = reached[index] if reached else None
    if seconds is None:
        return None
    # A solve that the clock does not see counts as a microsecond.
    return max(1e-6, seconds + (0.0 if prepared else float(np.median(row.values["set_up_s"]))))


def find_best(
    rows: Sequence[Row], solver: str, index: int, setting: str = "", *, prepared: bool = False
) -> dict[str, float | None]:
    """Give the least time [s] of a solver's settings from rest to an accuracy, by problem; None where not reached."""
    best: dict[str, float | None] = {}
    for row in rows:
        values = row.values
        if values["solver"] != solver or values["start"] != REST or setting not in ("", values["setting"]):
            continue
        seconds, known = find_time(row, index, prepared=prepared), best.get(row.case)
        best[row.case] = seconds if known is None else known if seconds is None else min(known, seconds)
    return best


def faster(
    one: str, other: str, index: int, settings: tuple[str, str] = ("", ""), *, prepared: bool = False
) -> Callable[[Sequence[Row]], Sides]:
    """Give the time of `one` over that of `other` to an accuracy, by problem; 0 where `other` never arrives.

    Problems that begin within the accuracy are left out.
    """

    def figures(rows: Sequence[Row]) -> Sides:
        mine, its = (
            find_best(rows, solver, index, setting, prepared=prepared)
            for solver, setting in zip((one, other), settings, strict=True)
        )
        starts: dict[str, float] = {}
        for row in (row for row in rows if row.values["solver"] in (one, other)):
            starts[row.case] = max(starts.get(row.case, 0.0), row.values.get("first_mm", 1e9))
        ratios: dict[str, float | None] = {}
        for case, seconds in mine.items():
            rival = its.get(case)
            if starts[case] <= ACCURACIES[index]:
                continue
            if seconds is None and rival is not None:
                ratios[case] = None
            elif seconds is not None and case in its:
                ratios[case] = 0.0 if rival is None else seconds / rival
        return ratios

    return figures


def ends_within(
    solver: str, bound: float, key: str = "floor_mm", start: str = REST, setting: str = ""
) -> Callable[[Sequence[Row]], Sides]:
    """Give a row's error [mm] over a bound, of the best setting, by problem."""

    def figures(rows: Sequence[Row]) -> Sides:
        ends: dict[str, float | None] = {}
        for row in rows:
            values: Values = row.values
            if values["solver"] != solver or values["start"] != start or setting not in values["setting"]:
                continue
            end, known = values.get(key), ends.get(row.case)
            ratio = None if end is None else end / bound
            ends[row.case] = ratio if known is None else known if ratio is None else min(known, ratio)
        return ends

    return figures


def grows(solver: str, index: int, easy: str, hard: str, factor: float) -> Callable[[Sequence[Row]], Sides]:
    """Give the time on a hard problem over that on an easy one and over `factor`."""

    def figures(rows: Sequence[Row]) -> Sides:
        times = find_best(rows, solver, index)
        if times.get(easy) is None or hard not in times:
            return {}
        late, soon = times[hard], times[easy]
        assert soon is not None
        return {hard: None if late is None else late / soon / factor}

    return figures


SOFT, TIGHT = "cube twisted, nu 0.3", "cube twisted, nu 0.4999"
EVEN, UNEVEN = "cube twisted, nu 0.45", "cube twisted, half 100 times as stiff"
CLAIMS = (
    Claim(
        "Local and global steps of projective dynamics are faster than Newton, to 1 mm.",
        "Bouaziz et al. 2014, Projective dynamics",
        faster(PD_PLAIN, FENICSX, ONE),
        "time over FEniCSx'",
    ),
    Claim(
        "They stay faster to 0.01 mm.",
        "the same, as it is often cited",
        faster(PD_PLAIN, FENICSX, HUNDREDTH),
        "time over FEniCSx'",
    ),
    Claim(
        "L-BFGS over the same factor is faster than plain projective dynamics.",
        "Liu et al. 2017, Quasi-Newton methods for real-time simulation",
        faster(PD, PD_PLAIN, HUNDREDTH),
        "time to 0.01 mm over plain's",
    ),
    Claim(
        "L-BFGS over that factor is faster than Newton.",
        "the same",
        faster(PD, FENICSX, HUNDREDTH),
        "time to 0.01 mm over FEniCSx'",
    ),
    Claim(
        "Anderson's acceleration makes projective dynamics faster.",
        "Peng et al. 2018, Anderson acceleration for geometry optimization",
        faster(PD_ANDERSON, PD_PLAIN, HUNDREDTH),
        "time to 0.01 mm over plain's",
    ),
    Claim(
        "L-BFGS beats Anderson.",
        "common talk",
        faster(PD, PD_ANDERSON, HUNDREDTH),
        "time to 0.01 mm over Anderson's",
    ),
    Claim(
        "Vertex block descent converges: within 0.01 mm of its law's answer.",
        "Chen et al. 2024, Vertex block descent",
        ends_within("Newton VBD", 0.01),
        "least error over 0.01 mm",
    ),
    Claim(
        "Vertex block descent keeps still at its answer, within 0.01 mm, by the package's defaults.",
        "follows from the one before",
        ends_within("Newton VBD", 0.01, "max_mm", ANSWER, "(default)"),
        "distance over 0.01 mm",
    ),
    Claim(
        "Vertex block descent is faster than Newton, to 0.1 mm, on a CPU.",
        "common talk; its paper compares on GPUs",
        faster("Newton VBD", "FElupe", TENTH),
        "time over FElupe's",
    ),
    Claim(
        "A long implicit step comes to rest sooner than the default one.",
        "MuJoCo's documentation of flex and of implicit integrators",
        faster("MuJoCo flex", "MuJoCo flex", HUNDREDTH, ("20 ms", "2 ms (default)")),
        "time to 0.01 mm of 20 ms over 2 ms",
    ),
    Claim(
        "Simulators of robots, brought to rest, are as fast as finite elements, to 0.1 mm.",
        "common talk",
        faster("MuJoCo flex", "FElupe", TENTH),
        "MuJoCo's time over FElupe's",
    ),
    Claim(
        "Multigrid and conjugate gradients beat a sparse direct solver in Newton.",
        "common talk",
        faster("FElupe", "FElupe", THOUSANDTH, ("pyamg", "direct (default)")),
        "time to 0.001 mm of pyamg over direct",
    ),
    Claim(
        "L-BFGS beats local and global steps on the energy of as-rigid-as-possible deformation.",
        "Liu et al. 2017",
        faster(PD_ARAP, LIBIGL_ARAP, HUNDREDTH),
        "time to 0.01 mm over libigl's",
    ),
    Claim(
        "Newton takes at most twice as long at a Poisson's ratio of 0.4999 as at 0.3.",
        "common talk",
        grows(FENICSX, HUNDREDTH, SOFT, TIGHT, 2.0),
        "growth over 2",
    ),
    Claim(
        "Projective dynamics takes at most twice as long there.",
        "common talk has the contrary",
        grows(PD, HUNDREDTH, SOFT, TIGHT, 2.0),
        "growth over 2",
    ),
    Claim(
        "Projective dynamics takes at most twice as long where half is 100 times as stiff.",
        "Overby et al. 2017, ADMM ⊇ projective dynamics, has the contrary",
        grows(PD, HUNDREDTH, EVEN, UNEVEN, 2.0),
        "growth over 2",
    ),
)
