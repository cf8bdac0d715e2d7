"""Every hard case through every solver that it is for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from ...reference import problems
from ..harness.gates import at_most
from ..harness.runner import Row
from ..harness.study import Column, Study, Table, Task, Values
from .asked import solvers_asked


@dataclass(frozen=True)
class Hard(Study):
    """Random starts, collapse, crush, twist, slivers, long steps."""

    name = "hard"
    heading = "Do the solvers survive hard cases?"
    question = "Where solvers are pushed hard: are they right, do they say why they stop, or are they silently wrong?"
    columns = (
        Column("criterion", "what is compared"),
        Column("outcome", "outcome"),
        Column("error", "error"),
        Column("bound", "bound"),
        Column("passed", "no fault"),
        Column("iterations", "iterations", cost=True),
    )

    solvers: tuple[str, ...] = field(default=(), metadata={"help": "only these; repeat for several  [all]"})
    laws: bool = field(
        default=False, metadata={"help": "also every law on every element of FEniCSx: a quarter of an hour"}
    )

    def tasks(self) -> Sequence[Task]:
        """Each case by each solver, and element, that it is for."""
        solvers = solvers_asked(self.solvers)
        return [task for task, (_, solver, _) in self._ways().items() if solver in solvers]

    def _ways(self) -> Mapping[Task, tuple[problems.HardCase, str, str]]:
        of_laws = problems.LAWS_ON_ELEMENTS if self.laws else ()
        posed = (*problems.HARD, *problems.added_hard_cases(), *of_laws)
        return {
            Task(f"{case.name} ({case.source.split(';')[0]})", f"{solver} {element}"): (case, solver, element)
            for case in posed
            for solver, element in case.ways
        }

    def measure(self, task: Task) -> Values:
        """The outcome; no error of what was refused, or came to nothing near the answer."""
        outcome = problems.run_hard(*self._ways()[task])
        error = outcome.error if np.isfinite(outcome.error) else None
        return asdict(outcome) | {"passed": outcome.passed, "error": error}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """No case is missed, or ended for another reason than it may."""
        return [at_most("cases with a fault", sum(not row.values["passed"] for row in rows), 0)]

    def words(self, rows: Sequence[Row]) -> str:
        """How many are right, and how many stopped for a reason that is right to name."""
        kinds = Counter(map(_kind, rows))
        right, refused, wrong = (kinds[kind] for kind in KINDS)
        return f"Of {len(rows)} cases {right} are right, {refused} stop with the reason they should, {wrong} are wrong."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Right, refused with a reason, or wrong, by solver and element; and of each case, seeds and laws together."""
        ways = list(dict.fromkeys(row.method for row in rows))
        outcomes = Counter((row.method, _kind(row)) for row in rows)
        counts = [[way, *(outcomes[way, kind] for kind in KINDS)] for way in ways]
        found: dict[str, dict[str, list[Row]]] = {}
        for row in rows:
            kind = row.case.split(", seed ")[0] + (" (H1)" if ", seed " in row.case else "")
            found.setdefault(kind, {}).setdefault(row.method, []).append(row)
        lines = [[kind, *(_told(by.get(way, [])) for way in ways)] for kind, by in found.items()]
        note = "Of the runs of a case, seeds among them: how many are right, refused with a reason, wrong; iterations."
        return [
            Table("By solver and element", ["solver and element", *KINDS], counts),
            Table("Right, refused, wrong", ["case", *ways], lines, note),
        ]


KINDS = ("right", "refused", "WRONG")


def _kind(row: Row) -> str:
    return KINDS[0] if row.values["outcome"] == "passed" else KINDS[1] if row.values["passed"] else KINDS[2]


def _told(rows: Sequence[Row]) -> str | None:
    """As "20 right, 8 to 31 iterations"."""
    if not rows:
        return None
    kinds = Counter(map(_kind, rows))
    counts = sorted(int(row.values["iterations"]) for row in rows)
    span = f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"
    outcome = ", ".join(kind if len(rows) == 1 else f"{count} {kind}" for kind, count in kinds.items())
    return f"{outcome}; {span}"
