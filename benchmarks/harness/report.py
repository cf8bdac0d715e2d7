"""One report of many studies: a page, and the same as Markdown, JSON and LaTeX; it reads results alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from ...animation.plots import narrow_figures
from ...lhm.base.errors import InputError, escape, quote
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.provenance import is_dirty
from .. import first_screen
from .page import drawn, machine_rows, panels_of, rendered, rows_table
from .page import shown as shown_study
from .results_file import of_this_version, read_results
from .runner import Results, Row
from .study import Study, Table
from .tables import latex, markdown

QUESTIONS: Mapping[str, tuple[str, ...]] = {
    "Is the fast simulator right?": ("agreement", "verification", "effects", "dynamics"),
    "Where is it wrong?": ("hard", "material", "convergence", "locking", "shapes"),
    "How far is the network from it?": ("surrogate", "split"),
    "What does each method cost?": ("work-precision", "throughput", "scaling", "unknowns", "ranks", "parts", "mixed"),
    "What can a scene leave out?": ("minimal",),
    "Which heads work?": ("heads", "depth"),
}
"""A reader's questions, and the studies that answer each, in the report's order."""
OTHER = "What else was measured?"
PICTURED = ("agreement", "effects", "heads")
"""Studies whose first picture may stand on the first screen."""
PROVENANCE = (
    "study",
    "commit",
    "holds all its code",
    "load at the start",
    "processor time [s]",
    "wall time of its rows [s]",
)


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
        reason = escape(" ".join(str(error).split()))[:120]
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
            raise InputError(f"options {name}: got {quote(value)}, expected as {quote(default)}")
    return kind(**options)


def write(
    studies: Sequence[Made], out: Path, title: str, failed: Sequence[tuple[str, str]] = (), spent: str = ""
) -> list[Path]:
    """The report's files: index.html, report.md, report.json, and tables.tex.

    `failed`: studies that were not run, and why; `spent`: a sentence on the cost of this run. Raises InputError where
    there is no study, two of one name, or results that another version has made.
    """
    named = {made.results.study: made for made in studies}
    if not studies or len(named) < len(studies):
        raise InputError("report: results of one study or more are needed, and of each study once")
    groups = _grouped(named)
    ordered = {name: named[name] for names in groups.values() for name in names}
    sections = {}
    for name, made in ordered.items():
        with of_this_version(f"report, {name}"):
            sections[name] = shown_study(made.study, made.results, made.folder)
    with of_this_version("report"):
        files = _files(ordered, groups, sections, title, failed, spent)
    for name, written in files.items():
        write_whole(out / name, written.encode())
    return [out / name for name in files]


def _files(
    ordered: Mapping[str, Made], groups: Mapping[str, Sequence[str]], sections: Mapping[str, dict[str, Any]],
    title: str, failed: Sequence[tuple[str, str]], spent: str,
) -> dict[str, str]:  # fmt: skip
    """The texts of the report's files by name."""
    missed = [
        (sections[name]["heading"], gate["what"], gate["value"], gate["bound"])
        for name, made in ordered.items()
        for gate in made.results.gates
        if not gate["passed"]
    ]
    provenance = _provenance(ordered, sections)
    cost = " ".join(text for text in (_cost(ordered), spent) if text)
    content = {"first": _first_screen(ordered), "missed": missed, "failed": failed, "sections": sections,
               "groups": groups, "cost": cost, "provenance": provenance}  # fmt: skip
    machine = machine_rows(next(iter(ordered.values())).results.machine)
    return {
        "index.html": rendered(
            "report_of_studies.html", {"title": title}, machine=machine, columns=PROVENANCE, **content
        ),
        "report.md": _as_markdown(title, content),
        "report.json": json.dumps({name: made.results.json() for name, made in ordered.items()}, indent=1),
        "tables.tex": "\n".join(
            latex(table, f"{name} {table.caption}") for name, made in ordered.items() for table in _tables(made)
        ),
    }


def _grouped(named: Mapping[str, Made]) -> dict[str, list[str]]:
    """The names of the studies that are there, by the question that they answer."""
    groups = {question: [name for name in names if name in named] for question, names in QUESTIONS.items()}
    asked = {name for names in QUESTIONS.values() for name in names}
    groups[OTHER] = [name for name in named if name not in asked]
    return {question: names for question, names in groups.items() if names}


def _first_screen(named: Mapping[str, Made]) -> dict[str, Any]:
    """The question, five sentences, one figure for a wide and a narrow screen, and one picture by caption."""
    rows = first_screen.values_of(made.results for made in named.values())
    wide = first_screen.figure(rows)
    with narrow_figures():
        slim = first_screen.figure(rows)
    pictures = (picture for name in PICTURED if name in named for picture in _pictures(named[name]))
    return {
        "asked": first_screen.ASKED,
        "sentences": first_screen.sentences(rows),
        "figures": {first_screen.CAPTION: (wide, slim)} if wide else {},
        "pictures": dict([picture] if (picture := next(pictures, None)) else []),
    }


def _pictures(made: Made) -> Iterator[tuple[str, list[str]]]:
    """The pictures of faces of a study, its head cut open left out."""
    for row in made.results.rows:
        for caption, png in drawn(row, made.folder, ".png") if row.done else ():
            if row.case != "the head":
                yield caption, panels_of(png)


def _provenance(named: Mapping[str, Made], sections: Mapping[str, dict[str, Any]]) -> list[tuple]:
    """A line per study: commits, whether their trees were clean, load at the start, processor seconds."""
    return [
        (sections[name]["heading"], ", ".join(each.commits), not any(map(is_dirty, each.commits)),
         each.machine["load"], each.cpu, sum(row.seconds for row in each.rows))
        for name, each in ((name, made.results) for name, made in named.items())
    ]  # fmt: skip


def _cost(named: Mapping[str, Made]) -> str:
    """The processor time of all rows that measured it, in a sentence."""
    rows = [row for made in named.values() for row in made.results.rows]
    measured = [row.cpu for row in rows if row.cpu is not None]
    if not measured:
        return ""
    return f"{len(measured)} of {len(rows)} rows took {sum(measured):.0f} s of processor time together."


def _tables(made: Made) -> list[Table]:
    done = [row for row in made.results.rows if row.done]
    return [*made.study.tables(done), rows_table(made.study, done)] if done else []


def _as_markdown(title: str, content: Mapping[str, Any]) -> str:
    first, sections = content["first"], content["sections"]
    parts = [f"# {title}", first["asked"], *(f"- {sentence}" for sentence in first["sentences"])]
    parts += [f"The study {name} could not be run: {why}" for name, why in content["failed"]]
    for question, names in content["groups"].items():
        parts.append(f"## {question}")
        for section in (sections[name] for name in names):
            parts += [f"### {section['heading']}", section["words"]]
            parts.append(markdown(Table("Statements", ["statement", "measured", "bound", "reached"], section["gates"])))
            if section["failed"]:
                unmeasured = Table("What could not be measured", ["case", "method", "", "why"], section["failed"])
                parts.append(markdown(unmeasured))
            parts += [markdown(table) for table in (*section["tables"], section["rows"])]
    parts += [markdown(Table("Where it was measured", PROVENANCE, content["provenance"])), content["cost"]]
    return "\n\n".join(part for part in parts if part) + "\n"
