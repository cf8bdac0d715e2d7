"""One report of many studies: a page, and the same as Markdown, JSON and LaTeX; it reads results alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.provenance import is_dirty
from ..contest import collect_rows
from ..studies import group_studies
from . import first_screen
from .page import collect_content, describe_gate, render_template, tabulate_machine
from .results import read_results, refuse_file, refuse_other_versions
from .study import Results, Row, Study, Table


@dataclass(frozen=True, eq=False)
class ReportPart:
    """A study with its results, and the folder that holds the pictures of its rows."""

    study: Study
    results: Results
    folder: Path


def read_part(path: Path, load_study: Callable[[str], type[Study]]) -> ReportPart:
    """Read a study's results file, or that of a folder. Options that the study has no more are left out.

    Raises InputError for what is no such file, and for results that this version's study would not have.
    """
    file = path / "results.json" if path.is_dir() else path
    content = read_results(file)
    with refuse_file(file):
        rows = tuple(Row(**row) for row in content["rows"])
        results = Results(**(content | {"rows": rows, "gates": tuple(content["gates"])}))
        kind = load_study(results.study)
        options = {name: tuple(value) if isinstance(value, list) else value for name, value in results.options.items()}
        there = {field.name for field in fields(kind)}  # type: ignore[arg-type]  # every study is a dataclass
        return ReportPart(kind(**{name: options[name] for name in there & options.keys()}), results, file.parent)


def write_report(
    parts: Sequence[ReportPart], out: Path, title: str, failed: Sequence[tuple[str, str]] = (), spent: str = ""
) -> list[Path]:
    """Write the report's files: index.html, report.md, report.json, and tables.tex.

    `failed`: studies that were not run, and why; `spent`: a sentence on the cost of this run. Raises InputError where
    there is no study, two of one name, or results that another version has made.
    """
    named = {part.results.study: part for part in parts}
    if not parts or len(named) < len(parts):
        raise InputError("report: results of one study or more are needed, and of each study once")
    groups = group_studies(named)
    ordered = {name: named[name] for names in groups.values() for name in names}
    with refuse_other_versions(f"report of {quote(', '.join(ordered), 200)}"):
        sections = {name: collect_content(part.study, part.results, part.folder) for name, part in ordered.items()}
        content: dict[str, Any] = {
            "title": title,
            "first": _collect_first_screen(ordered),
            "missed": [
                (sections[name]["question"], describe_gate(gate), gate["value"], gate["bound"])
                for name, part in ordered.items()
                for gate in part.results.gates
                if not gate["passed"] and gate["answer"]  # bounds of speed hang on the machine
            ],
            "failed": failed,
            "sections": sections,
            "groups": groups,
            "spent": spent,
            "provenance": _tabulate_provenance(ordered),
            "machine": tabulate_machine(next(iter(ordered.values())).results.machine),
        }
        files = {
            "index.html": render_template("report_of_studies.html", **content),
            "report.md": render_template("report.md", **content),
            "report.json": json.dumps({name: part.results.json() for name, part in ordered.items()}, indent=1),
            "tables.tex": render_template("tables.tex", **content),
        }
    for name, text in files.items():
        write_whole(out / name, text.encode())
    return [out / name for name in files]


def _collect_first_screen(ordered: Mapping[str, ReportPart]) -> dict[str, Any]:
    """Collect what is compared, sentences, tables and a figure."""
    faces = ordered.get("faces")
    lines = [] if faces is None else collect_rows(faces.results.rows)
    figure = first_screen.draw_figure(lines)
    return {
        "asked": first_screen.ASKED,
        "sentences": first_screen.write_sentences(lines),
        "tables": first_screen.tabulate(lines),
        "figures": {first_screen.CAPTION: figure} if figure else {},
    }


def _tabulate_provenance(ordered: Mapping[str, ReportPart]) -> Table:
    head = ["study", "commit", "holds all its code", "load at the start", "processor time [s]", "wall time of rows [s]"]
    rows = [
        (part.study.question, ", ".join(part.results.commits),
         not any(map(is_dirty, part.results.commits)), part.results.machine["load"], part.results.cpu,
         sum(row.seconds for row in part.results.rows))
        for part in ordered.values()
    ]  # fmt: skip
    return Table("Where it was measured", head, rows)
