"""A study as data: cases by methods, what is measured of each, and what has to hold."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from ...lhm.base import provenance
from ...lhm.base.errors import MissingDependencyError, SoftdecaError
from ...lhm.head.gates import Direction, is_within
from ...reference.added import NotModelledError

Values = Mapping[str, Any]
"""The values of a task, as JSON has them: numbers, texts, lists of them. PNG pictures are bytes under their caption,
and arrays stand under their name; both become files, whose names stand in their place. A NaN makes the row a failure.
"""


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
    """A table that is computed from the rows: caption, titles with units, cells, and a note beneath."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    note: str = ""

    @classmethod
    def of(cls, caption: str, titles: Mapping[str, str], lines: Iterable[Values], note: str = "") -> Table:
        """Tabulate the values of lines, whose titles are given by key."""
        return cls(caption, [*titles.values()], [tuple(line.get(key) for key in titles) for line in lines], note)


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
    """A study's rows in the order of its tasks, its gates and its conclusion.

    decided_by: digests of what decides its figures beside its options, by name; empty in results of older versions.
    """

    study: str
    question: str
    options: Mapping[str, Any]
    machine: Mapping[str, Any]
    rows: tuple[Row, ...]
    gates: tuple[dict, ...]
    words: str
    decided_by: Mapping[str, str] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether every gate holds that asks for a right answer; those of speed hang on the machine."""
        return all(gate["passed"] for gate in self.gates if gate["answer"])

    @property
    def commits(self) -> list[str]:
        """The commits of the last run, and of runs before it whose rows were kept."""
        return provenance.list_commits(self.machine, [{"commit": row.commit} for row in self.rows])

    @property
    def cpu(self) -> float | None:
        """Processor time [s] of all rows that measured it; None where none did."""
        measured = [row.cpu for row in self.rows if row.cpu is not None]
        return sum(measured) if measured else None

    def json(self) -> dict[str, Any]:
        """Give the content of a results file."""
        return asdict(self)


class Study(ABC):
    """A frozen dataclass, whose fields are what is asked of it; `softdeca bench NAME` has those made by `option`.

    It travels to another process by pickle and there measures one task at a time. Where seconds are compared it is
    `timed`: its tasks run one after another, and nothing of ours beside them. Where memory is, each has a process
    `alone`; others share one, so that packages are loaded once. A task that takes more than `limit` [s] is ended.
    """

    name: ClassVar[str]
    question: ClassVar[str]
    """In few words: it is a heading of pages, too."""
    columns: ClassVar[tuple[Column, ...]]
    note: ClassVar[str] = ""
    """How the rows are measured."""
    timed: ClassVar[bool] = False
    alone: ClassVar[bool] = False
    limit: ClassVar[float] = 3600.0
    version: ClassVar[int] = 1
    """Raise it when the same options would mean other figures; rows of other versions are measured anew."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Names of INPUTS (`inputs.py`) that decide its figures; rows of others are measured anew."""
    cheap: ClassVar[str] = ""
    """PART whose rows are measured anew to see whether kept results still hold; empty where all take minutes."""
    allowed: ClassVar[float] = 1e-3
    """Share of itself by which an answer that is measured anew may differ from the kept one."""

    @abstractmethod
    def tasks(self) -> Sequence[Task]:
        """List the tasks. Raises InputError for options out of range."""

    @abstractmethod
    def measure(self, task: Task) -> Values:
        """Do one task. An error becomes the row's reason; MissingDependencyError and NotModelledError skip it."""

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give the report's lines of a task: one, or those of its `rows` where it answers several questions."""
        lines: Sequence[Values] = values.get("rows", [values])
        return lines

    def conclude(self, rows: Sequence[Row]) -> Sequence[Row]:
        """Make rows that follow from those that are done, such as limits; gates, words and tables see them too."""
        return ()

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Make the statements that must hold by `at_most`, `at_least` and `above`; one more says that no row failed."""
        return []

    def words(self, rows: Sequence[Row]) -> str:
        """Write the conclusion, its numbers from the rows."""
        return ""

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Make the tables that follow from the rows together."""
        return []

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw figures as SVG text, by caption."""
        return {}


def describe_failure(error: BaseException) -> tuple[str, str]:
    """Describe what a task or a method raised: its status, "skipped" or "failed", and the reason."""
    skipped = isinstance(error, MissingDependencyError | NotModelledError)
    reason = str(error) if isinstance(error, SoftdecaError) else f"{type(error).__name__}: {error}"
    return "skipped" if skipped else "failed", " ".join(reason.split())


def at_most(what: str, value: float | None, bound: float, *, answer: bool = True) -> dict:
    """Make a gate, a statement with a value and a bound; None, what was not measured, does not pass."""
    return _make_gate(what, value, "at most", bound, answer)


def at_least(what: str, value: float | None, bound: float, *, answer: bool = True) -> dict:
    """Make a gate with a bound from below."""
    return _make_gate(what, value, "at least", bound, answer)


def above(what: str, value: float, bound: float) -> dict:
    """Make a gate with a bound from below that is left out."""
    return _make_gate(what, value, "above", bound, True)


def _make_gate(what: str, value: float | None, direction: Direction, bound: float, answer: bool) -> dict:
    passed = value is not None and is_within(value, direction, bound)
    return {"what": what, "value": value, "bound": f"{direction} {bound:g}", "passed": bool(passed), "answer": answer}
