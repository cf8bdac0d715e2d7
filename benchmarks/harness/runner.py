"""The runner of every study: rows in a file as they come, resumed, and a page and a results file of them."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from ...lhm.errors import InputError
from ...lhm.files.alone import alone_in
from ...lhm.files.atomic import write_whole
from ...lhm.progress import OnProgress, silent
from ...reference.added import added_files
from ...surrogate.schedule import processors
from . import machine
from .gates import at_most
from .lanes import Measured, measured
from .study import Study, Task, Values

Only = Literal["missing", "failed", "all"]
PNG = b"\x89PNG"
PACKAGE = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Row:
    """A task and how it ended ("done", "skipped", "failed"); seconds of all of it, memory [MB], and the load then."""

    case: str
    method: str
    status: str
    reason: str
    values: Values
    seconds: float
    memory_mb: float | None
    load: float
    of: str = field(repr=False)

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

    def json(self) -> dict[str, Any]:
        """For a results file."""
        return asdict(self)


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

    Rows of the same options, code and versions are kept: `only` "failed" does those that failed again, "all" every one.
    `match` chooses tasks by a part of their names. `workers` processes side by side, by default all processors, and
    one where seconds are compared. Raises InputError where nothing matches and where the folder is in use.
    """
    tasks = [task for task in study.tasks() if match.lower() in str(task).lower()]
    if not tasks:
        raise InputError(f"{study.name}: no case and method matches {match!r}")
    with alone_in(out, f"run of {study.name}"):
        with_what = machine.describe()
        rows = _Rows(out / "rows.jsonl", _digest(study))
        again = {"missing": (), "failed": ("failed", "skipped"), "all": ("failed", "skipped", "done")}[only]
        left = [task for task in tasks if (row := rows.found.get(task)) is None or row.status in again]
        lanes = 1 if study.timed else workers or processors()
        progress(f"{study.name}: {len(tasks) - len(left)} of {len(tasks)}", 1.0 - len(left) / len(tasks))
        for number, one in enumerate(measured(study, left, lanes), 1):
            rows.add(one)
            ended = "" if one.status == "done" else f", {one.status}"
            progress(f"{study.name}: {one.task}{ended}", 1.0 - (len(left) - number) / len(tasks))
        results = _results(study, [rows.found[task] for task in tasks], with_what)
        write_whole(out / "results.json", json.dumps(results.json(), indent=1, allow_nan=False).encode())
        from .page import page

        write_whole(out / "index.html", page(study, results, out).encode())
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
        self._path, self._of = path, of
        self.found: dict[Task, Row] = {}
        for line in path.read_text().splitlines() if path.is_file() else ():
            try:
                row = Row(**json.loads(line))
            except (ValueError, TypeError):
                continue  # torn by a kill; its task is done again
            if row.of == of:
                self.found[Task(row.case, row.method)] = row

    def add(self, one: Measured) -> None:
        values, wrong = _said(self._drawn(one))
        status, reason = ("failed", f"not finite: {', '.join(wrong)}") if wrong else (one.status, one.reason)
        row = Row(
            one.task.case, one.task.method, status, reason, values, round(one.seconds, 4), one.memory_mb,
            machine.load(), self._of,
        )  # fmt: skip
        self.found[one.task] = row
        line = json.dumps(asdict(row), allow_nan=False)
        torn = self._path.is_file() and not self._path.read_bytes().endswith(b"\n")
        with self._path.open("a") as file:
            file.write(("\n" if torn else "") + line + "\n")
            file.flush()

    def _drawn(self, one: Measured) -> Values:
        """The values, with the names of files that now hold their pictures and pages."""
        found = dict(one.values)
        for key, value in one.values.items():
            if isinstance(value, bytes):
                kind = ".png" if value.startswith(PNG) else ".html"
                name = re.sub(r"[^A-Za-z0-9.+*-]+", "-", f"{one.task}, {key}")[:120].strip("-") + kind
                write_whole(self._path.parent / name, value)
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
    """A name for what is measured, and by what: rows of two versions must not be mixed."""
    digest = hashlib.sha256(repr(study).encode() + json.dumps(machine.describe()["versions"]).encode())
    for path in (*_files(study), *added_files()):
        digest.update(path.read_bytes())
    for folder in ("lhm", "reference", "surrogate", "benchmarks"):
        for path in sorted((PACKAGE / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
