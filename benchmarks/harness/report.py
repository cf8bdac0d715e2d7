"""One report of many studies: a page, and the same as Markdown, JSON and LaTeX; it reads results alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ...lhm.errors import InputError
from ...lhm.files.atomic import write_whole
from .page import machine_rows, rendered, rows_table, shown
from .runner import Results, Row
from .study import Study, Table
from .tables import latex, markdown

QUESTIONS: Mapping[str, tuple[str, ...]] = {
    "Is projective dynamics right?": ("agreement", "verification", "effects", "dynamics"),
    "Where is it not?": ("hard", "material", "convergence", "locking", "shapes"),
    "How far is the surrogate from a reference, and why?": ("split", "surrogate"),
    "What does it cost?": ("work-precision", "throughput", "scaling", "unknowns", "ranks", "parts", "mixed"),
    "What may be left out?": ("minimal",),
    "On whose heads?": ("heads", "depth"),
}
"""What a reader comes for, and the studies that answer it, in the report's order."""
FIRST = "split"
"""Whose figure a reader sees first: all errors in one."""


@dataclass(frozen=True, eq=False)
class Made:
    """A study with its results, and the folder that holds the pictures of its rows."""

    study: Study
    results: Results
    folder: Path


def read(path: Path, kind_of: Callable[[str], type[Study]]) -> Made:
    """The study of a results file of `run`, or of the folder with one.

    Raises InputError for what is no such file, and for results that this version's study would not have.
    """
    file = path / "results.json" if path.is_dir() else path
    try:
        found = json.loads(file.read_text())
        found["rows"] = tuple(Row(**row) for row in found["rows"])
        results = Results(**(found | {"gates": tuple(found["gates"])}))
        kind = kind_of(results.study)
        known = {field.name for field in fields(kind)}  # type: ignore[arg-type]  # every study is a dataclass
        options = {key: tuple(value) if isinstance(value, list) else value for key, value in results.options.items()}
        study = kind(**{key: value for key, value in options.items() if key in known})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: no results of a study ({type(error).__name__})") from None
    return Made(study, results, file.parent)


def write(studies: Sequence[Made], out: Path, title: str, failed: Sequence[tuple[str, str]] = ()) -> list[Path]:
    """The report's files: index.html, report.md, report.json, and tables.tex; `failed`, studies that were not run, why.

    Raises InputError where there is no study, two of one name, or results that another version has made.
    """
    named = {made.results.study: made for made in studies}
    if not studies or len(named) < len(studies):
        raise InputError("report: results of one study or more are needed, and of each study once")
    try:
        sections = {name: shown(made.study, made.results, made.folder) for name, made in _ordered(named).items()}
    except KeyError as error:
        raise InputError(f"report: results without {error}, made by another version; run that study again") from None
    conclusion = concluded(named)
    missed = [
        (made.results.study, gate["what"], gate["value"], gate["bound"])
        for made in named.values()
        for gate in made.results.gates
        if not gate["passed"]
    ]
    machines = [(name, made.results.machine["commit"], made.results.machine["load"]) for name, made in named.items()]
    first = next(iter(named.values())).results.machine
    files = {
        "index.html": rendered(
            "report_of_studies.html", {"title": title}, conclusion=conclusion, missed=missed, failed=failed,
            sections=sections, machines=machines, machine=machine_rows(first),
        ),
        "report.md": _as_markdown(title, conclusion, failed, sections),
        "report.json": json.dumps({name: made.results.json() for name, made in named.items()}, indent=1),
        "tables.tex": "\n".join(
            latex(table, f"{name} {table.caption}") for name, made in named.items() for table in _tables(made)
        ),
    }  # fmt: skip
    for name, content in files.items():
        write_whole(out / name, content.encode())
    return [out / name for name in files]


def concluded(named: Mapping[str, Made]) -> list[tuple[str, str]]:
    """Each question that a study answers, and the answers, whose numbers are those of its rows."""
    found = []
    for question, names in QUESTIONS.items():
        words = " ".join(named[name].results.words for name in names if name in named and named[name].results.words)
        if words:
            found.append((question, words))
    return found


def _ordered(named: Mapping[str, Made]) -> dict[str, Made]:
    asked = [name for names in QUESTIONS.values() for name in names]
    return {name: named[name] for name in dict.fromkeys([FIRST, *asked, *named]) if name in named}


def _tables(made: Made) -> list[Table]:
    done = [row for row in made.results.rows if row.done]
    return [*made.study.tables(done), rows_table(made.study, done)] if done else []


def _as_markdown(
    title: str, conclusion: Sequence[tuple[str, str]], failed: Sequence[tuple[str, str]],
    sections: Mapping[str, dict[str, Any]],
) -> str:  # fmt: skip
    parts = [f"# {title}", *(f"**{question}** {words}" for question, words in conclusion)]
    parts += [f"The study {name} could not be run: {why}" for name, why in failed]
    for name, section in sections.items():
        parts += [f"## {name}", section["question"], section["words"]]
        parts.append(markdown(Table("Statements", ["statement", "measured", "bound", "reached"], section["gates"])))
        if section["failed"]:
            unmeasured = Table("What could not be measured", ["case", "method", "", "why"], section["failed"])
            parts.append(markdown(unmeasured))
        parts += [markdown(table) for table in (*section["tables"], section["rows"])]
    return "\n\n".join(part for part in parts if part) + "\n"
