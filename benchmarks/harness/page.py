"""The page of a study: its question, conclusion and gates, pictures, and its rows beneath."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from ..report import machine_rows, rendered
from .runner import Results, Row
from .study import Study, Values


def page(study: Study, results: Results) -> str:
    """Self-contained HTML."""
    done = [row for row in results.rows if row.done]
    costs = ["seconds"] + (["peak memory [MB]"] if study.alone else [])
    return rendered(
        "study.html",
        {"title": study.name},
        question=study.question,
        words=results.words,
        gate_rows=[(gate["what"], gate["value"], gate["bound"], gate["passed"]) for gate in results.gates],
        pictures={
            caption: base64.b64encode(png).decode() for caption, png in (study.pictures(done) if done else {}).items()
        },
        head=["case", "method", *(column.title for column in study.columns), *costs],
        rows=[_cells(study, row, values) for row in done for values in study.lines(row.values)],
        failed=[(row.case, row.method, row.status, row.reason) for row in results.rows if not row.done],
        option_rows=list(results.options.items()),
        machine_rows=machine_rows(results.machine),
    )


def _cells(study: Study, row: Row, values: Values) -> list[Any]:
    cells = [row.case, row.method, *(shown(values.get(column.key)) for column in study.columns), row.seconds]
    return cells + ([row.memory_mb] if study.alone else [])


def shown(value: Any) -> Any:
    """A value as a cell: repeated ones by their median."""
    if isinstance(value, (list, tuple)):
        return float(np.median(value)) if value and not isinstance(value[0], str) else ", ".join(map(str, value))
    return value
