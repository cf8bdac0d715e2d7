"""What the arena's rows say together: times over Poisson's ratio and contrast."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...harness.study import Row, Table
from .contest import ACCURACIES, HUNDREDTH, REST, TENTH

SERIES = {
    "nu 0.3": "cube twisted, nu 0.3",
    "0.4": "cube twisted, nu 0.4",
    "0.45, all alike": "cube twisted, nu 0.45",
    "0.49": "cube twisted, nu 0.49",
    "0.4999": "cube twisted, nu 0.4999",
    "half 10 times as stiff": "cube twisted, half 10 times as stiff",
    "100 times": "cube twisted, half 100 times as stiff",
}
"""Problems of one shape by what differs."""


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


def find_best(rows: Sequence[Row], solver: str, index: int, *, prepared: bool = False) -> dict[str, float | None]:
    """Give the least time [s] of a solver's settings from rest to an accuracy, by problem; None where not reached."""
    best: dict[str, float | None] = {}
    for row in rows:
        values = row.values
        if values["solver"] != solver or values["start"] != REST:
            continue
        seconds, known = find_time(row, index, prepared=prepared), best.get(row.case)
        best[row.case] = seconds if known is None else known if seconds is None else min(known, seconds)
    return best


def tabulate_times(rows: Sequence[Row]) -> Table:
    """Tabulate each solver's processor time from rest to the accuracies."""
    return _tabulate_arrivals(rows, "seconds_to", "Processor time of the solve to an accuracy", " [s]")


JAWS = {"14.5 k tets": "head's jaw opened, 14.5 k tets", "58 k tets": "head's jaw opened, 58 k tets"}
FACES = {
    "without its membrane": "face posed without its membrane, 14.5 k tets",
    "by Eq. 15": "face posed by Eq. 15, 14.5 k tets",
}
"""Problems of one kind by what differs."""


def tabulate_best(rows: Sequence[Row], what: str, cases: Mapping[str, str]) -> Table:
    """Tabulate each solver's least time with set-up to 0.1 and 0.01 mm and its least error at the end, over settings.

    Solvers that solve none of the problems are left out.
    """
    lines = []
    for solver in dict.fromkeys(row.values["solver"] for row in rows):
        tenths, hundredths = (find_best(rows, solver, accuracy) for accuracy in (TENTH, HUNDREDTH))
        own = [row for row in rows if row.values["solver"] == solver and row.values["start"] == REST]
        line: list = [solver, own[0].values["law"]]
        for case in cases.values():
            ends = [row.values["max_mm"] for row in own if row.case == case and row.values["max_mm"] is not None]
            line += [tenths.get(case), hundredths.get(case), min(ends, default=None)]
        if any(cell is not None for cell in line[2:]):
            lines.append(tuple(line))
    head = [f"{name}: {column}" for name in cases for column in ("to 0.1 mm [s]", "to 0.01 mm [s]", "end [mm]")]
    return Table(f"{what}: time with set-up, best setting", ["solver", "law", *head], lines)


def tabulate_work(rows: Sequence[Row]) -> Table:
    """Tabulate each solver's iterations from rest to the accuracies."""
    return _tabulate_arrivals(rows, "work_to", "Iterations to an accuracy", "")


def _tabulate_arrivals(rows: Sequence[Row], key: str, caption: str, unit: str) -> Table:
    solved = [(row, row.values.get(key) or ()) for row in rows if row.values["start"] == REST]
    shown = max((len(reached) for _, reached in solved), default=0)
    lines = [
        (row.case, row.values["solver"], row.values["setting"], *reached, *[None] * (shown - len(reached)))
        for row, reached in solved
    ]
    head = ["problem", "solver", "setting", *(f"to {accuracy:g} mm{unit}" for accuracy in ACCURACIES[:shown])]
    return Table(caption, head, lines)


def tabulate_series(rows: Sequence[Row]) -> Table:
    """Tabulate each solver's least time with set-up to 0.1 and 0.01 mm on the twisted cube."""
    lines = []
    for solver in dict.fromkeys(row.values["solver"] for row in rows if row.case in SERIES.values()):
        for accuracy in (TENTH, HUNDREDTH):
            best = find_best(rows, solver, accuracy)
            lines.append((solver, ACCURACIES[accuracy], *(best.get(case) for case in SERIES.values())))
    head = ["solver", "to [mm]", *(f"{name} [s]" for name in SERIES)]
    return Table("Time with set-up over Poisson's ratio and contrast, best setting", head, lines)
