"""Two results of one study side by side: what changed by more than its noise."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.errors import InputError
from .study import Study

LEAST = 0.02
"""Share below which no change of a cost is told, however quiet the machine."""


@dataclass(frozen=True)
class Change:
    """A cost of one task before and after, the share that is noise, and whether it got worse or better by more."""

    task: str
    what: str
    before: float
    after: float
    noise: float

    @property
    def share(self) -> float:
        """After over before, less one."""
        return self.after / self.before - 1.0 if self.before else float("inf") if self.after else 0.0

    @property
    def told(self) -> bool:
        """Whether it is more than noise."""
        return abs(self.share) > max(LEAST, 3.0 * self.noise)


def read(path: Path) -> Mapping[str, Any]:
    """A results file of `run`, or the folder with one; InputError if it is none."""
    file = path / "results.json" if path.is_dir() else path
    try:
        found = json.loads(file.read_text())
        return {"study": found["study"], "rows": {f"{r['case']}, {r['method']}": r for r in found["rows"]}}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: no results of a study ({type(error).__name__})") from None


def study_in(path: Path) -> str:
    """The name of the study that a results file is of; InputError as of `read`."""
    name: str = read(path)["study"]
    return name


def compared(before: Path, after: Path, kind: type[Study]) -> tuple[list[Change], list[str]]:
    """Costs of the tasks that both have done, and in words what only one has done.

    A cost that is a list of repeated values counts by its median, and its noise is their median distance from that.
    """
    old, new = read(before), read(after)
    if old["study"] != new["study"]:
        raise InputError(f"{before} is of {old['study']!r}, {after} of {new['study']!r}: they cannot be compared")
    changes, only = [], []
    for task in [*old["rows"], *(task for task in new["rows"] if task not in old["rows"])]:
        was, now = old["rows"].get(task), new["rows"].get(task)
        states = tuple("missing" if row is None else row["status"] for row in (was, now))
        if states != ("done", "done"):
            if states[0] != states[1]:
                only.append(f"{task}: {states[0]} before, {states[1]} after")
            continue
        costs = [column for column in kind.columns if column.cost]
        for a, b in zip(kind.lines(was["values"]), kind.lines(now["values"]), strict=False):
            for column in costs:
                if a.get(column.key) is not None and b.get(column.key) is not None:
                    changes.append(_change(task, column.title, a[column.key], b[column.key]))
    return changes, only


def _change(task: str, what: str, before: float | Sequence[float], after: float | Sequence[float]) -> Change:
    (a, a_noise), (b, b_noise) = _middle(before), _middle(after)
    return Change(task, what, a, b, max(a_noise, b_noise))


def _middle(value: float | Sequence[float]) -> tuple[float, float]:
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    middle = float(np.median(values))
    return middle, float(np.median(np.abs(values - middle)) / middle) if middle else 0.0
