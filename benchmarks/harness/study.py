"""A study as data: cases by methods, what is measured of each, and what has to hold."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from ...lhm.base import provenance

Values = Mapping[str, Any]
"""What was measured of a task, as JSON can say it: numbers, texts, lists of them; and as bytes PNG pictures and HTML
pages, whose key is their caption, and which become the names of files. A NaN makes the row a failure."""


@dataclass(frozen=True)
class Task:
    """One case by one method, both as they are named in the report."""

    case: str
    method: str

    def __str__(self) -> str:
        return f"{self.case}, {self.method}"


@dataclass(frozen=True)
class Column:
    """A column of the report: the key of `Values` that it shows, its title with unit; `cost` where less is better."""

    key: str
    title: str
    cost: bool = False


@dataclass(frozen=True)
class Table:
    """A table that is computed of the rows: its caption, titles with units, cells, and what one has to know of it."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    note: str = ""


@dataclass(frozen=True)
class Row:
    """A task and how it ended ("done", "skipped", "failed").

    `seconds` are wall time, `cpu` is processor time [s], None where nobody measured it; memory [MB]; the load then.
    commit: of the code that measured it, which a later run may have kept; empty in results of older versions.
    """

    case: str
    method: str
    status: str
    reason: str
    values: Values
    seconds: float
    memory_mb: float | None
    load: float
    of: str = field(repr=False)
    commit: str = ""
    cpu: float | None = None

    @property
    def done(self) -> bool:
        """Whether it has values."""
        return self.status == "done"


@dataclass(frozen=True)
class Results:
    """A study's rows in the order of its tasks, its gates and its conclusion."""

    study: str
    question: str
    options: Mapping[str, Any]
    machine: Mapping[str, Any]
    rows: tuple[Row, ...]
    gates: tuple[dict, ...]
    words: str

    @property
    def passed(self) -> bool:
        """Whether every gate holds that asks for a right answer; those of speed hang on the machine."""
        return all(gate["passed"] for gate in self.gates if gate["answer"])

    @property
    def commits(self) -> list[str]:
        """Of the last run, and of runs before it whose rows were kept."""
        return provenance.list_commits(self.machine, [{"commit": row.commit} for row in self.rows])

    @property
    def cpu(self) -> float | None:
        """Processor time [s] of all rows that measured it; None where none did."""
        measured = [row.cpu for row in self.rows if row.cpu is not None]
        return sum(measured) if measured else None

    def json(self) -> dict[str, Any]:
        """For a results file."""
        return asdict(self)


class Study(ABC):
    """A frozen dataclass, whose fields are the options of `softdeca bench NAME`; `metadata["help"]` explains each.

    It travels to another process by pickle and there measures one task at a time. Where seconds are compared it is
    `timed`: its tasks run one after another, and nothing of ours beside them. Where memory is, each has a process
    `alone`; others share one, so that packages are loaded once. A task that takes more than `limit` [s] is ended.
    """

    name: ClassVar[str]
    heading: ClassVar[str] = ""
    """The question as a heading of a page, in few words; by default `question`."""
    question: ClassVar[str]
    columns: ClassVar[tuple[Column, ...]]
    note: ClassVar[str] = ""
    """What one has to know of the rows: how they are measured."""
    timed: ClassVar[bool] = False
    alone: ClassVar[bool] = False
    limit: ClassVar[float] = 3600.0
    version: ClassVar[int] = 1
    """Raise it when the same options would mean other figures; rows of other versions are measured anew."""

    @abstractmethod
    def tasks(self) -> Sequence[Task]:
        """What there is to do. Raises InputError for options out of range."""

    @abstractmethod
    def measure(self, task: Task) -> Values:
        """Do one task. What it raises becomes the row's reason; MissingDependencyError and NotModelledError skip it."""

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """What the report shows of a task: one line, or those of its `rows` where it answers several questions."""
        lines: Sequence[Values] = values.get("rows", [values])
        return lines

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """What has to hold, by `at_most`, `at_least` or `above`, beside that no row failed."""
        return []

    def words(self, rows: Sequence[Row]) -> str:
        """The conclusion in prose, its numbers from the rows."""
        return ""

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """What follows from the rows together."""
        return []

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Figures as SVG text by caption."""
        return {}


def at_most(what: str, value: float | None, bound: float, *, answer: bool = True) -> dict:
    """One statement; None, what was not measured, does not pass."""
    return _gate(what, value, f"at most {bound:g}", value is not None and value <= bound, answer)


def at_least(what: str, value: float | None, bound: float, *, answer: bool = True) -> dict:
    """The same from below."""
    return _gate(what, value, f"at least {bound:g}", value is not None and value >= bound, answer)


def above(what: str, value: float, bound: float) -> dict:
    """The same from below, the bound left out."""
    return _gate(what, value, f"above {bound:g}", value > bound, True)


def _gate(what: str, value: float | None, bound: str, passed: bool, answer: bool) -> dict:
    return {"what": what, "value": value, "bound": bound, "passed": bool(passed), "answer": answer}
