"""The runner of every study: rows in a file as they come, resumed, and a page and a results file of them."""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base import provenance
from ...lhm.base.errors import InputError, SoftdecaError
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.files.resumable import add_row, lock_folder, read_rows
from ...lhm.base.progress import OnProgress, silent
from ...reference.added import added_files
from ...surrogate.corpus.schedule import count_processors
from .inputs import find_inputs
from .page import collect_content, render_template
from .processes import Job, Outcome, measure_jobs
from .study import Results, Row, Study, Task, Values, at_most

EVERY = 20.0
"""[s] between two looks at results while tasks run."""


@dataclass(frozen=True)
class RunRequest:
    """A study to run, its folder, and the part of names that its tasks must have."""

    study: Study
    out: Path
    match: str = ""


def run(
    study: Study,
    out: Path,
    *,
    workers: int | None = None,
    match: str = "",
    progress: OnProgress = silent,
) -> Results:
    """Do the tasks of a study that are not done yet, or failed; write OUT/rows.jsonl, results.json and index.html.

    The page's figures are OUT/figure-1.svg and so on, too. Rows of the same options, study version, inputs and package
    versions are kept. `match` chooses tasks by a part of their names. `workers` processes side by side, by default all
    processors, and one where seconds are compared. Raises InputError where nothing matches and where the folder is in
    use.
    """
    (results,) = run_together([RunRequest(study, out, match)], workers=workers, progress=progress)
    if isinstance(results, SoftdecaError):
        raise results
    return results


def run_together(
    requests: Sequence[RunRequest],
    *,
    workers: int | None = None,
    progress: OnProgress = silent,
    on_results: Callable[[Sequence[Results]], object] | None = None,
) -> list[Results | SoftdecaError]:
    """Run several studies, as `run`; they share their processes, so that none waits for the end of one before the next.

    In place of results, why a study could not be run. Where seconds of one are compared, all run one after another.
    on_results: sees what is there after the first task, and then at most every EVERY seconds.
    """
    ends: list[Results | SoftdecaError | None] = [None] * len(requests)
    runs: dict[int, _Run] = {}
    with ExitStack() as folders:
        for number, request in enumerate(requests):
            try:
                runs[number] = _Run(request, folders)
            except SoftdecaError as error:
                ends[number] = error
        jobs = {Job(run.study, task): number for number, run in runs.items() for task in run.left}
        lanes = 1 if any(run.study.timed for run in runs.values()) else workers or count_processors()
        count = sum(len(run.tasks) for run in runs.values())
        if runs:
            names = ", ".join(run.study.name for run in runs.values())
            progress(f"{names}: {count - len(jobs)} of {count}", 1.0 - len(jobs) / count)
        seen = -math.inf
        for done, outcome in enumerate(measure_jobs(list(jobs), lanes), 1):
            run = runs[jobs[outcome.job]]
            run.add(outcome)
            ended = "" if outcome.status == "done" else f", {outcome.status}"
            progress(f"{run.study.name}: {outcome.job.task}{ended}", 1.0 - (len(jobs) - done) / count)
            if on_results is not None and time.monotonic() - seen >= EVERY:
                on_results([each.write() for each in runs.values() if each.has_rows])
                seen = time.monotonic()
        for number, run in runs.items():
            ends[number] = run.write()
    return [each for each in ends if each is not None]


class _Run:
    """One study of those that run together: its folder, which is locked, its tasks, and its rows by task.

    Rows on disk that were written with other options, versions or files are ignored.
    """

    def __init__(self, request: RunRequest, folders: ExitStack):
        self.study, self._out = request.study, request.out
        self.tasks = [task for task in self.study.tasks() if request.match.lower() in str(task).lower()]
        if not self.tasks:
            raise InputError(f"{self.study.name}: no case and method matches {request.match!r}")
        folders.enter_context(lock_folder(self._out, f"run of {self.study.name}"))
        self._machine = provenance.describe_machine()
        self._inputs = find_inputs(self.study)
        self._digest = _digest(self.study, self._machine, self._inputs)
        names = {field.name for field in fields(Row)}
        self._rows: dict[Task, Row] = {
            Task(record["case"], record["method"]): Row(**record)
            for record in read_rows(self._out / "rows.jsonl")
            if record.get("of") == self._digest and record.keys() == names
        }
        self.left = [task for task in self.tasks if task not in self._rows or not self._rows[task].done]

    @property
    def has_rows(self) -> bool:
        """Whether a task of it is done."""
        return bool(self._rows)

    def add(self, outcome: Outcome) -> None:
        """Keep what a task gave; pictures and arrays become files, whose names stand in the row."""
        task, values = outcome.job.task, dict(outcome.values)
        for key, value in outcome.values.items():
            if isinstance(value, (bytes, np.ndarray)):
                content, kind = (_as_npy(value), ".npy") if isinstance(value, np.ndarray) else (value, ".png")
                name = re.sub(r"[^A-Za-z0-9.+*-]+", "-", f"{task}, {key}")[:120].strip("-") + kind
                write_whole(self._out / name, content)
                values[key] = name
        values, wrong = _as_json(values)
        status, reason = outcome.status, outcome.reason
        if wrong:
            status, reason = "failed", f"not finite: {', '.join(wrong)}"
        cpu = None if outcome.cpu is None else round(outcome.cpu, 4)
        row = Row(
            task.case, task.method, status, reason, values, round(outcome.seconds, 4), outcome.memory_mb,
            provenance.read_load(), self._digest, provenance.read_commit(), cpu,
        )  # fmt: skip
        self._rows[task] = row
        add_row(self._out / "rows.jsonl", asdict(row))

    def write(self) -> Results:
        """Write the results of the rows that are there, and their page."""
        study, rows = self.study, [self._rows[task] for task in self.tasks if task in self._rows]
        done = [row for row in rows if row.done]
        missing = sum(row.status == "failed" for row in rows) if done else len(rows)
        failed = at_most("cases that could not be measured", missing, 0)
        concluded = study.conclude(done)
        rows, done = [*rows, *concluded], [*done, *concluded]
        gates = (failed, *(study.gates(done) if done else ()))
        options = json.loads(json.dumps(asdict(study), default=str))  # type: ignore[call-overload]  # a dataclass
        words = study.words(done) if done else "Nothing could be measured."
        if len(rows) < len(self.tasks) + len(concluded):
            words = f"{len(self.tasks) + len(concluded) - len(rows)} tasks are not done yet. {words}"
        results = Results(study.name, study.question, options, self._machine, tuple(rows), gates, words, self._inputs)
        write_whole(self._out / "results.json", json.dumps(results.json(), indent=1, allow_nan=False).encode())
        content = collect_content(study, results, self._out)
        for number, svg in enumerate(content["figures"].values(), 1):
            write_whole(self._out / f"figure-{number}.svg", svg.encode())
        page = render_template("study.html", title=content["question"], study=content)
        write_whole(self._out / "index.html", page.encode())
        return results


def _as_npy(array: np.ndarray) -> bytes:
    """Content of a .npy file."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def _as_json(values: Values) -> tuple[dict[str, Any], list[str]]:
    """Values as JSON has them, None for what is not finite, and the names of those."""
    wrong: list[str] = []

    def convert(value: Any, name: str) -> Any:
        if isinstance(value, Mapping):
            return {key: convert(item, f"{name}{key}") for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [convert(item, name) for item in value]
        if hasattr(value, "item") and getattr(value, "ndim", 0) == 0:
            value = value.item()
        if isinstance(value, float) and not math.isfinite(value):
            wrong.append(name)
            return None
        return value

    return convert(values, ""), sorted(set(wrong))


def _digest(study: Study, machine: Mapping[str, Any], inputs: Mapping[str, str]) -> str:
    """Name what is measured, so that rows of two meanings never mix: options, inputs, package versions, files.

    Files are those that options name, as FILE or ict:FILE.
    """
    digest = hashlib.sha256(json.dumps([repr(study), inputs, machine["versions"]]).encode())
    values = [getattr(study, field.name) for field in fields(study)]  # type: ignore[arg-type]  # a dataclass
    texts = [text for value in values for text in (value if isinstance(value, tuple) else (value,))]
    paths = [Path(text.rpartition(":")[2]) for text in texts if isinstance(text, str) and text]
    for path in (*filter(Path.is_file, paths), *added_files()):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
