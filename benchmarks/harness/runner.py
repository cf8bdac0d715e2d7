"""The runner of every study: rows in a file as they come, resumed, and a page and a results file of them."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from ...lhm.base import provenance
from ...lhm.base.errors import InputError, SoftdecaError
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.files.resumable import RowStore, lock_folder
from ...lhm.base.progress import OnProgress, silent
from ...reference.added import added_files
from ...surrogate.schedule import count_processors
from .gates import at_most
from .lanes import Job, Measured, measured
from .study import Study, Task, Values

Only = Literal["missing", "failed", "all"]
PNG = b"\x89PNG"


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


@dataclass(frozen=True)
class Asked:
    """A study to run, its folder, and the part of names that its tasks must have."""

    study: Study
    out: Path
    match: str = ""


def run(
    study: Study,
    out: Path,
    *,
    only: Only = "missing",
    workers: int | None = None,
    match: str = "",
    progress: OnProgress = silent,
) -> Results:
    """Do the tasks of a study that are not done yet; write OUT/rows.jsonl, results.json and index.html.

    Rows of the same options, study version and package versions are kept: `only` "failed" does those that failed
    again, "all" every one. `match` chooses tasks by a part of their names. `workers` processes side by side, by default
    all processors, and one where seconds are compared. Raises InputError where nothing matches and where the folder is
    in use.
    """
    (found,) = run_together([Asked(study, out, match)], only=only, workers=workers, progress=progress)
    if isinstance(found, SoftdecaError):
        raise found
    return found


def run_together(
    asked: Sequence[Asked], *, only: Only = "missing", workers: int | None = None, progress: OnProgress = silent
) -> list[Results | SoftdecaError]:
    """As `run` for several studies, which share their processes, so that none waits for the end of one before the next.

    In place of results, why a study could not be run. Where seconds of one are compared, all run one after another.
    """
    found: list[Results | SoftdecaError | None] = [None] * len(asked)
    runs: dict[int, _Run] = {}
    with ExitStack() as folders:
        for number, each in enumerate(asked):
            try:
                runs[number] = _Run(each, only, folders)
            except SoftdecaError as error:
                found[number] = error
        jobs = {Job(run.study, task): number for number, run in runs.items() for task in run.left}
        lanes = 1 if any(run.study.timed for run in runs.values()) else workers or count_processors()
        count = sum(len(run.tasks) for run in runs.values())
        if runs:
            named = ", ".join(run.study.name for run in runs.values())
            progress(f"{named}: {count - len(jobs)} of {count}", 1.0 - len(jobs) / count)
        for done, one in enumerate(measured(list(jobs), lanes), 1):
            run = runs[jobs[one.job]]
            run.rows.add(one)
            ended = "" if one.status == "done" else f", {one.status}"
            progress(f"{run.study.name}: {one.job.task}{ended}", 1.0 - (len(jobs) - done) / count)
        for number, run in runs.items():
            found[number] = run.written()
    return [each for each in found if each is not None]


class _Run:
    """One study of those that run together, its folder held."""

    def __init__(self, asked: Asked, only: Only, folders: ExitStack):
        self.study, self._out = asked.study, asked.out
        self.tasks = [task for task in self.study.tasks() if asked.match.lower() in str(task).lower()]
        if not self.tasks:
            raise InputError(f"{self.study.name}: no case and method matches {asked.match!r}")
        folders.enter_context(lock_folder(self._out, f"run of {self.study.name}"))
        self._with_what = provenance.describe_machine()
        self.rows = _Rows(self._out / "rows.jsonl", _digest(self.study))
        again = {"missing": (), "failed": ("failed", "skipped"), "all": ("failed", "skipped", "done")}[only]
        known = self.rows.found
        self.left = [task for task in self.tasks if (row := known.get(task)) is None or row.status in again]

    def written(self) -> Results:
        """The results of all rows, with their file and page."""
        from .page import page

        results = _results(self.study, [self.rows.found[task] for task in self.tasks], self._with_what)
        write_whole(self._out / "results.json", json.dumps(results.json(), indent=1, allow_nan=False).encode())
        write_whole(self._out / "index.html", page(self.study, results, self._out).encode())
        return results


def _results(study: Study, rows: Sequence[Row], with_what: Mapping[str, Any]) -> Results:
    done = [row for row in rows if row.done]
    missing = sum(row.status == "failed" for row in rows) if done else len(rows)
    failed = at_most("cases that could not be measured", missing, 0)
    gates = (failed, *(study.gates(done) if done else ()))
    options = json.loads(json.dumps(asdict(study), default=str))  # type: ignore[call-overload]  # all are dataclasses
    words = study.words(done) if done else "Nothing could be measured."
    return Results(study.name, study.question, options, with_what, tuple(rows), gates, words)


class _Rows:
    """The rows of a file, of which those of other options or code are not looked at, and one more at a time."""

    def __init__(self, path: Path, of: str):
        self._records, self._of = RowStore(path.parent, file=path.name), of
        self.found: dict[Task, Row] = {}
        names = {field.name for field in fields(Row)}
        for record in self._records.rows():
            if record.get("of") == of and record.keys() == names:
                self.found[Task(record["case"], record["method"])] = Row(**record)

    def add(self, one: Measured) -> None:
        task = one.job.task
        values, wrong = _said(self._drawn(one))
        status, reason = ("failed", f"not finite: {', '.join(wrong)}") if wrong else (one.status, one.reason)
        row = Row(
            task.case, task.method, status, reason, values, round(one.seconds, 4), one.memory_mb,
            provenance.read_load(), self._of, provenance.read_commit(), None if one.cpu is None else round(one.cpu, 4),
        )  # fmt: skip
        self.found[task] = row
        self._records.add(asdict(row))

    def _drawn(self, one: Measured) -> Values:
        """The values, with the names of files that now hold their pictures and pages."""
        found = dict(one.values)
        for key, value in one.values.items():
            if isinstance(value, bytes):
                kind = ".png" if value.startswith(PNG) else ".html"
                name = re.sub(r"[^A-Za-z0-9.+*-]+", "-", f"{one.job.task}, {key}")[:120].strip("-") + kind
                write_whole(self._records.folder / name, value)
                found[key] = name
        return found


def _said(values: Values) -> tuple[dict[str, Any], list[str]]:
    """Values as JSON can say them, None for what is not finite, and the names of those."""
    wrong: list[str] = []

    def said(value: Any, name: str) -> Any:
        if isinstance(value, Mapping):
            return {key: said(item, f"{name}{key}") for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [said(item, name) for item in value]
        if hasattr(value, "item") and getattr(value, "ndim", 0) == 0:
            value = value.item()
        if isinstance(value, float) and not math.isfinite(value):
            wrong.append(name)
            return None
        return value

    return said(values, ""), sorted(set(wrong))


def _files(study: Study) -> list[Path]:
    """Those that its options name, as FILE or ict:FILE."""
    values = [getattr(study, field.name) for field in fields(study)]  # type: ignore[arg-type]  # all are dataclasses
    texts = [text for value in values for text in (value if isinstance(value, tuple) else (value,))]
    paths = [Path(text.rpartition(":")[2]) for text in texts if isinstance(text, str) and text]
    return [path for path in paths if path.is_file()]


def _digest(study: Study) -> str:
    """Name what is measured, so that rows of two meanings never mix: options, version, package versions, files."""
    about = [repr(study), study.version, provenance.describe_machine()["versions"]]
    digest = hashlib.sha256(json.dumps(about).encode())
    for path in (*_files(study), *added_files()):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
