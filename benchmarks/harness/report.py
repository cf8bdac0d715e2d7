"""One report of many studies: a page, and the same as Markdown, JSON and LaTeX; it reads results alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from ...lhm.bounds import plain, shown
from ...lhm.errors import InputError
from ...lhm.files.atomic import write_whole
from .machine import is_dirty
from .page import machine_rows, rendered, rows_table
from .page import shown as shown_study
from .results_file import of_this_version, read_results
from .runner import Results, Row
from .study import Study, Table
from .tables import latex, markdown

QUESTIONS: Mapping[str, tuple[str, ...]] = {
    "Is projective dynamics right?": ("agreement", "verification", "effects", "dynamics"),
    "Where is it not?": ("hard", "material", "convergence", "shapes"),
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
    said = read_results(file)
    try:
        rows = tuple(Row(**row) for row in said["rows"])
        results = Results(**(said | {"rows": rows, "gates": tuple(said["gates"])}))
        study = _study(kind_of(results.study), results.options)
        if not isinstance(results.machine, dict) or not isinstance(results.words, str):
            raise InputError("machine and words: expected an object and a text")
        if not {"commit", "load"} <= set(results.machine):
            raise InputError("machine: no commit, or no load")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        reason = plain(" ".join(str(error).split()))[:120]
        raise InputError(f"{file}: no results of a study ({type(error).__name__}: {reason})") from None
    return Made(study, results, file.parent)


def _study(kind: type[Study], said: Mapping[str, Any]) -> Study:
    """Make the study of these options, each of the kind of its default; those that it has no more are left out."""
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]  # every study is a dataclass
    options = {
        name: tuple(value) if isinstance(value, list) else value for name, value in said.items() if name in known
    }
    for name, value in options.items():
        default = known[name].default
        good = (int, float) if isinstance(default, float) else type(default)
        if default is not MISSING and not isinstance(value, good):
            raise InputError(f"options {name}: got {shown(value)}, expected as {shown(default)}")
    return kind(**options)


def write(studies: Sequence[Made], out: Path, title: str, failed: Sequence[tuple[str, str]] = ()) -> list[Path]:
    """The report's files: index.html, report.md, report.json, and tables.tex; `failed`, studies that were not run, why.

    Raises InputError where there is no study, two of one name, or results that another version has made.
    """
    named = {made.results.study: made for made in studies}
    if not studies or len(named) < len(studies):
        raise InputError("report: results of one study or more are needed, and of each study once")
    sections = {}
    for name, made in _ordered(named).items():
        with of_this_version(f"report, {name}"):
            sections[name] = shown_study(made.study, made.results, made.folder)
    with of_this_version("report"):
        files = _files(named, title, sections, failed)
    for name, content in files.items():
        write_whole(out / name, content.encode())
    return [out / name for name in files]


def _files(
    named: Mapping[str, Made], title: str, sections: Mapping[str, dict[str, Any]], failed: Sequence[tuple[str, str]]
) -> dict[str, str]:
    """The texts of the report's files by name."""
    conclusion = concluded(named)
    missed = [
        (made.results.study, gate["what"], gate["value"], gate["bound"])
        for made in named.values()
        for gate in made.results.gates
        if not gate["passed"]
    ]
    machines = [
        (name, made.results.machine["commit"], not is_dirty(made.results.machine), made.results.machine["load"])
        for name, made in named.items()
    ]
    first = next(iter(named.values())).results.machine
    return {
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
