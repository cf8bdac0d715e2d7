"""Two results of one study side by side: costs and answers that changed by more than their noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from .results_file import of_this_version, read_results
from .study import Column, Study

LEAST = 0.02
"""Share below which no change is told, however quiet the machine."""
ROUNDING = 1e-3
"""Of the largest value of an answer's column over all tasks: errors far below that differ by rounding alone."""


@dataclass(frozen=True)
class Change:
    """A value of one task before and after, by how much it may differ by noise, and whether it is a cost."""

    task: str
    what: str
    before: float
    after: float
    noise: float
    cost: bool

    @property
    def share(self) -> float:
        """After over before, less one."""
        return self.after / self.before - 1.0 if self.before else float("inf") if self.after else 0.0

    @property
    def told(self) -> bool:
        """Whether it is more than noise."""
        return abs(self.after - self.before) > self.noise


@dataclass(frozen=True)
class Comparison:
    """All values that both results have; and in words what else differs: for the worse (`broken`), or not."""

    changes: list[Change]
    broken: list[str]
    other: list[str]


def read(path: Path) -> Mapping[str, Any]:
    """Return study, rows by name and gates by name of a results file, or of the folder with one; see `read_results`."""
    said = read_results(path)
    rows = {f"{row['case']}, {row['method']}": row for row in said["rows"]}
    gates = {gate["what"]: gate["passed"] for gate in said["gates"]}
    return {"study": said["study"], "rows": rows, "gates": gates}


def study_in(path: Path) -> str:
    """The name of the study that a results file is of; InputError as of `read`."""
    name: str = read(path)["study"]
    return name


def compared(before: Path, after: Path, kind: type[Study]) -> Comparison:
    """Costs and answers of the tasks that both have done, and what only one has done, said or reached.

    A cost that is a list of repeated values counts by its median, and its noise is three times their median distance
    from that. Answers may differ by rounding. Raises InputError for what are no results of one study.
    """
    old, new = read(before), read(after)
    if old["study"] != new["study"]:
        raise InputError(f"{before} is of {old['study']!r}, {after} of {new['study']!r}: they cannot be compared")
    with of_this_version(f"{before} and {after}"):
        return _compared(old, new, kind)


def _compared(old: Mapping[str, Any], new: Mapping[str, Any], kind: type[Study]) -> Comparison:
    found = Comparison([], [], [])
    pairs: list[tuple[str, Column, Any, Any]] = []
    for task in [*old["rows"], *(task for task in new["rows"] if task not in old["rows"])]:
        was, now = old["rows"].get(task), new["rows"].get(task)
        states = tuple("missing" if row is None else row["status"] for row in (was, now))
        if states == ("done", "done"):
            for a, b in zip(kind.lines(was["values"]), kind.lines(now["values"]), strict=False):
                pairs += [(task, column, a.get(column.key), b.get(column.key)) for column in kind.columns]
        elif states[0] != states[1]:
            words = found.broken if states[0] == "done" else found.other
            words.append(f"{task}: {states[0]} before, {states[1]} after")
    for what, passed in old["gates"].items():
        if new["gates"].get(what, passed) != passed:
            words = found.broken if passed else found.other
            words.append(f"{what}: {'reached before, not after' if passed else 'not reached before, but after'}")
    numbers = [pair for pair in pairs if _is_number(pair[2]) and _is_number(pair[3])]
    scale: dict[str, float] = {}
    for _, column, a, b in numbers:
        scale[column.title] = np.nanmax(np.abs([scale.get(column.title, 0.0), _middle(a)[0], _middle(b)[0]]))
    found.changes.extend(_change(task, column, a, b, scale[column.title]) for task, column, a, b in numbers)
    for task, column, a, b in pairs:
        if isinstance(a, str) and isinstance(b, str) and a != b:
            found.other.append(f"{task}, {column.title}: {a} before, {b} after")
    return found


def _is_number(value: Any) -> bool:
    """Of a number, or of repeated ones."""
    several = value if isinstance(value, list) else [value]
    return bool(several) and all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in several)


def _change(task: str, column: Column, before: Any, after: Any, scale: float) -> Change:
    (a, a_noise), (b, b_noise) = _middle(before), _middle(after)
    rounding = 0.0 if column.cost else ROUNDING * scale
    noise = max(LEAST * abs(a), 3.0 * max(a_noise, b_noise), rounding)
    return Change(task, column.title, a, b, noise, column.cost)


def _middle(value: float | Sequence[float]) -> tuple[float, float]:
    """The median, and the median distance from it."""
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    middle = float(np.median(values))
    return middle, float(np.median(np.abs(values - middle)))
