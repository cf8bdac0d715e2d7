"""results.json of a study: checked before it is used, and two of them side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError, escape
from ...lhm.base.files.text import parse_json, read_bytes
from ...lhm.base.limits import RESULT_BYTES
from .study import Column, Study


def read_results(path: Path) -> dict[str, Any]:
    """Read a results file, or that of a folder: study, rows and gates. InputError names the file."""
    file = path / "results.json" if path.is_dir() else path
    with refuse_file(file):
        content: dict[str, Any] = parse_json(read_bytes(file, RESULT_BYTES))
        content.setdefault("gates", [])
        _ = content["study"], [row["values"] for row in content["rows"]]
    return content


@contextmanager
def refuse_file(file: Path) -> Iterator[None]:
    """Turn what is raised of a file that is no results of a study into an InputError that names it."""
    try:
        with refuse_other_versions("file"):
            yield
    except InputError as error:
        raise InputError(f"{file}: no results of a study ({error})") from None


@contextmanager
def refuse_other_versions(where: str) -> Iterator[None]:
    """Turn what a study's own code raises of values that are not its own into an InputError that names `where`."""
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError) as error:
        reason = escape(" ".join(str(error).split()))[:80]
        raise InputError(
            f"{where}: results damaged, or made by another version ({type(error).__name__}: {reason}); "
            "run that study again"
        ) from None


LEAST = 0.02
"""Share below which no change counts, however quiet the machine."""
ROUNDING = 1e-3
"""Changes below this share of a column's largest value over all tasks are rounding."""


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
    def is_beyond_noise(self) -> bool:
        """Whether it is more than noise."""
        return abs(self.after - self.before) > self.noise


@dataclass(frozen=True)
class Comparison:
    """All values that both results have; and in words what else differs: for the worse (`broken`), or not."""

    changes: list[Change]
    broken: list[str]
    other: list[str]


def compare_results(before: Path, after: Path, kind: type[Study]) -> Comparison:
    """Compare costs and answers of the tasks that both have done, and name what only one has done, content or reached.

    A cost that is a list of repeated values counts by its median, and its noise is three times their median distance
    from that. Answers may differ by rounding. Raises InputError for what are no results of one study.
    """
    old, new = read_results(before), read_results(after)
    if old["study"] != new["study"]:
        raise InputError(f"{before} is of {old['study']!r}, {after} of {new['study']!r}: they cannot be compared")
    comparison = Comparison([], [], [])
    pairs: list[tuple[str, Column, Any, Any]] = []
    with refuse_other_versions(f"{before} and {after}"):
        old_rows, new_rows = ({f"{row['case']}, {row['method']}": row for row in each["rows"]} for each in (old, new))
        for task in dict.fromkeys((*old_rows, *new_rows)):
            states = tuple(rows[task]["status"] if task in rows else "missing" for rows in (old_rows, new_rows))
            if states == ("done", "done"):
                lines = (kind.lines(rows[task]["values"]) for rows in (old_rows, new_rows))
                for a, b in zip(*lines, strict=False):
                    pairs += [(task, column, a.get(column.key), b.get(column.key)) for column in kind.columns]
            elif states[0] != states[1]:
                words = comparison.broken if states[0] == "done" else comparison.other
                words.append(f"{task}: {states[0]} before, {states[1]} after")
        reached = {gate["what"]: gate["passed"] for gate in new["gates"]}
        for what, passed in {gate["what"]: gate["passed"] for gate in old["gates"]}.items():
            if reached.get(what, passed) != passed:
                words = comparison.broken if passed else comparison.other
                words.append(f"{what}: {'reached before, not after' if passed else 'not reached before, but after'}")
        numbers = [pair for pair in pairs if is_number(pair[2]) and is_number(pair[3])]
        scale: dict[str, float] = {}
        for _, column, a, b in numbers:
            scale[column.title] = np.nanmax(
                np.abs([scale.get(column.title, 0.0), find_middle(a)[0], find_middle(b)[0]])
            )
        for task, column, a, b in numbers:
            (middle, noise), (middle_after, noise_after) = find_middle(a), find_middle(b)
            rounding = 0.0 if column.cost else ROUNDING * scale[column.title]
            noise = max(LEAST * abs(middle), 3.0 * max(noise, noise_after), rounding)
            comparison.changes.append(Change(task, column.title, middle, middle_after, noise, column.cost))
        for task, column, a, b in pairs:
            if isinstance(a, str) and isinstance(b, str) and a != b:
                comparison.other.append(f"{task}, {column.title}: {a} before, {b} after")
    return comparison


def is_number(value: Any) -> bool:
    """Whether a value is a number, or repeated ones."""
    several = value if isinstance(value, list) else [value]
    return bool(several) and all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in several)


def find_middle(value: float | Sequence[float]) -> tuple[float, float]:
    """The median, and the median distance from it."""
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    middle = float(np.median(values))
    return middle, float(np.median(np.abs(values - middle)))
