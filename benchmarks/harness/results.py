"""results.json of a study: checked before it is used, and two of them side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError, escape, quote
from ...lhm.base.files.text import parse_json, read_bytes
from ...lhm.base.limits import RESULT_BYTES
from .study import Column, Study

STATUSES = ("done", "skipped", "failed")
_KINDS: dict[str, tuple[type, ...]] = {
    "case": (str,),
    "method": (str,),
    "status": (str,),
    "values": (dict,),
    "reason": (str,),
    "seconds": (int, float),
    "memory_mb": (int, float, type(None)),
    "load": (int, float),
    "of": (str,),
    "commit": (str,),
}
"""Of a row's fields; the first four are in every row."""
_GATE: dict[str, tuple[type, ...]] = {
    "what": (str,),
    "passed": (bool,),
    "value": (int, float, type(None)),
    "bound": (str,),
    "answer": (bool,),
    "count": (int,),
}
"""Of a gate's fields; the first two are in every gate."""


def read_results(path: Path) -> dict[str, Any]:
    """Read a results file, or that of a folder: study, rows and gates of the right kinds.

    Raises InputError that names the file, and the row or gate.
    """
    file = path / "results.json" if path.is_dir() else path
    try:
        content = parse_json(read_bytes(file, RESULT_BYTES))
        if not isinstance(content, dict) or not isinstance(content.get("study"), str):
            raise InputError("expected an object with the name of its study")
        _check_list("row", content.get("rows"), _KINDS, 4)
        _check_list("gate", content.setdefault("gates", []), _GATE, 2)
        for number, row in enumerate(content["rows"]):
            if row["status"] not in STATUSES:
                raise InputError(f"row {number}, status: {quote(row['status'])}, expected one of {', '.join(STATUSES)}")
    except InputError as error:
        raise InputError(f"{file}: no results of a study ({error})") from None
    return content


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


def _check_list(name: str, items: Any, kinds: dict[str, tuple[type, ...]], needed: int) -> None:
    if not isinstance(items, list):
        raise InputError(f"{name}s: expected a list, got {quote(items)}")
    for number, item in enumerate(items):
        if not isinstance(item, dict):
            raise InputError(f"{name} {number}: expected an object, got {quote(item)}")
        for place, (key, types) in enumerate(kinds.items()):
            if key not in item and place < needed:
                raise InputError(f"{name} {number}: no {key}")
            if key in item and (
                not isinstance(item[key], types) or (isinstance(item[key], bool) and bool not in types)
            ):
                raise InputError(f"{name} {number}, {key}: got {quote(item[key])}")


LEAST = 0.02
"""Share below which no change counts, however quiet the machine."""
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
    old_rows, new_rows = ({f"{row['case']}, {row['method']}": row for row in each["rows"]} for each in (old, new))
    comparison = Comparison([], [], [])
    pairs: list[tuple[str, Column, Any, Any]] = []
    with refuse_other_versions(f"{before} and {after}"):
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
        numbers = [pair for pair in pairs if _is_number(pair[2]) and _is_number(pair[3])]
        scale: dict[str, float] = {}
        for _, column, a, b in numbers:
            scale[column.title] = np.nanmax(
                np.abs([scale.get(column.title, 0.0), _find_middle(a)[0], _find_middle(b)[0]])
            )
        for task, column, a, b in numbers:
            (middle, noise), (middle_after, noise_after) = _find_middle(a), _find_middle(b)
            rounding = 0.0 if column.cost else ROUNDING * scale[column.title]
            noise = max(LEAST * abs(middle), 3.0 * max(noise, noise_after), rounding)
            comparison.changes.append(Change(task, column.title, middle, middle_after, noise, column.cost))
        for task, column, a, b in pairs:
            if isinstance(a, str) and isinstance(b, str) and a != b:
                comparison.other.append(f"{task}, {column.title}: {a} before, {b} after")
    return comparison


UNSEEN = 1e-5
"""In the units of all columns, as mm: what moves by less is rounding, such as the distance of two converged answers."""


def find_moved(kept: Mapping[str, Any], anew: Mapping[str, Any], kind: type[Study]) -> list[str]:
    """Name the answers of rows measured anew that differ from the kept ones by more than the study allows, in words.

    Both are contents of results files. Of a row's many lines the first that moved is told, and how many more did. A row
    that is not done anew, that `kept` lacks, or that has another number of lines has moved.
    """
    moved: list[str] = []
    rows = {(row["case"], row["method"]): row for row in kept["rows"] if row["status"] == "done"}
    answers = [column for column in kind.columns if not column.cost]
    with refuse_other_versions(f"results of {kind.name}"):
        for row in anew["rows"]:
            task = f"{row['case']}, {row['method']}"
            before = rows.get((row["case"], row["method"]))
            if before is None:
                moved.append(f"{task}: not among the kept rows")
                continue
            if row["status"] != "done":
                moved.append(f"{task}: {row['status']}, {row['reason']}")
                continue
            old_lines, new_lines = kind.lines(before["values"]), kind.lines(row["values"])
            if len(old_lines) != len(new_lines):
                moved.append(f"{task}: {len(old_lines)} -> {len(new_lines)} lines")
            pairs = list(zip(old_lines, new_lines, strict=False))
            for column in answers:
                values = [(old.get(column.key), new.get(column.key)) for old, new in pairs]
                apart = [(a, b) for a, b in values if not _is_same(a, b, kind.allowed)]
                if apart:
                    (a, b), more = apart[0], f", and {len(apart) - 1} more lines" if len(apart) > 1 else ""
                    moved.append(f"{task}, {column.title}: {_shorten(a)} -> {_shorten(b)}{more}")
    return moved


def _is_same(a: Any, b: Any, share: float) -> bool:
    """Whether two values of an answer are one but for a share of them, or rounding."""
    if _is_number(a) and _is_number(b):
        middle, middle_after = _find_middle(a)[0], _find_middle(b)[0]
        return abs(middle_after - middle) <= max(share * abs(middle), UNSEEN)
    return bool(a == b)


def _shorten(value: Any) -> str:
    return f"{_find_middle(value)[0]:.6g}" if _is_number(value) else str(value)


def _is_number(value: Any) -> bool:
    """Whether a value is a number, or repeated ones."""
    several = value if isinstance(value, list) else [value]
    return bool(several) and all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in several)


def _find_middle(value: float | Sequence[float]) -> tuple[float, float]:
    """The median, and the median distance from it."""
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    middle = float(np.median(values))
    return middle, float(np.median(np.abs(values - middle)))
