"""One report of many studies: a page, and the same as Markdown, JSON and LaTeX; it reads results alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from ...lhm.base.errors import InputError, escape, quote
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.provenance import is_dirty
from ..contest import collect_rows
from ..studies import group_studies
from . import first_screen
from .page import (
    collect_content,
    describe_gate,
    encode_panels,
    read_files,
    render_template,
    tabulate_machine,
    to_latex,
    to_markdown,
)
from .results import read_results, refuse_other_versions
from .study import Results, Row, Study, Table

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
    try:
        rows = tuple(Row(**row) for row in content["rows"])
        results = Results(**(content | {"rows": rows, "gates": tuple(content["gates"])}))
        kind = load_study(results.study)
        options: dict[str, Any] = {}
        for field in fields(kind):  # type: ignore[arg-type]  # every study is a dataclass
            if field.name in results.options:
                value = results.options[field.name]
                value = tuple(value) if isinstance(value, list) else value
                good = (int, float) if isinstance(field.default, float) else type(field.default)
                if field.default is not MISSING and not isinstance(value, good):
                    raise InputError(f"options {field.name}: got {quote(value)}, expected as {quote(field.default)}")
                options[field.name] = value
        study = kind(**options)
        if not isinstance(results.machine, dict) or not isinstance(results.words, str):
            raise InputError("machine and words: expected an object and a text")
        if not {"commit", "load"} <= set(results.machine):
            raise InputError("machine: no commit, or no load")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        reason = escape(" ".join(str(error).split()))[:120]
        raise InputError(f"{file}: no results of a study ({type(error).__name__}: {reason})") from None
    return ReportPart(study, results, file.parent)


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
    sections = {}
    for name, part in ordered.items():
        with refuse_other_versions(f"report, {name}"):
            sections[name] = collect_content(part.study, part.results, part.folder)
            sections[name]["command"] = f"softdeca bench {name}"
    with refuse_other_versions(f"report of {quote(', '.join(ordered), 200)}"):
        content: dict[str, Any] = {
            "title": title,
            "first": _collect_first_screen(ordered),
            "missed": [
                (sections[name]["heading"], describe_gate(gate), gate["value"], gate["bound"])
                for name, part in ordered.items()
                for gate in part.results.gates
                if not gate["passed"] and gate["answer"]  # bounds of speed hang on the machine
            ],
            "failed": failed,
            "sections": sections,
            "groups": groups,
            "cost": " ".join(text for text in (_describe_cost(ordered), spent) if text),
            "provenance": [
                (sections[name]["heading"], ", ".join(each.commits), not any(map(is_dirty, each.commits)),
                 each.machine["load"], each.cpu, sum(row.seconds for row in each.rows))
                for name, each in ((name, part.results) for name, part in ordered.items())
            ],
        }  # fmt: skip
        machine = tabulate_machine(next(iter(ordered.values())).results.machine)
        tables = {name: [*section["tables"], section["rows"]] for name, section in sections.items()}
        files = {
            "index.html": render_template("report_of_studies.html", machine=machine, columns=PROVENANCE, **content),
            "report.md": _write_markdown(content),
            "report.json": json.dumps({name: part.results.json() for name, part in ordered.items()}, indent=1),
            "tables.tex": "\n".join(
                to_latex(table, f"{name} {table.caption}")
                for name, shown in tables.items()
                for table in (shown if any(row.done for row in ordered[name].results.rows) else ())
            ),
        }
    for name, text in files.items():
        write_whole(out / name, text.encode())
    return [out / name for name in files]


def _collect_first_screen(ordered: Mapping[str, ReportPart]) -> dict[str, Any]:
    """Collect the first screen: sentences, tables, one figure, and one picture by caption."""
    rows = {part.results.study: [row for row in part.results.rows if row.done] for part in ordered.values()}
    lines = collect_rows(rows.get("faces", ()))
    figure = first_screen.draw_figure(lines)
    pictures = (
        (caption, png)
        for name in PICTURED
        if name in ordered
        for row in rows[name]
        if row.case != "the head"  # which is cut open
        for caption, png in read_files(row, ordered[name].folder, ".png")
    )
    caption, png = next(pictures, ("", b""))
    return {
        "asked": first_screen.ASKED,
        "sentences": first_screen.write_sentences(lines),
        "tables": first_screen.tabulate(lines),
        "figures": {first_screen.CAPTION: figure} if figure else {},
        "pictures": {caption: encode_panels(png)} if png else {},
    }


def _describe_cost(ordered: Mapping[str, ReportPart]) -> str:
    """Tell the processor time of all rows that measured it."""
    rows = [row for part in ordered.values() for row in part.results.rows]
    measured = [row.cpu for row in rows if row.cpu is not None]
    if not measured:
        return ""
    return f"{len(measured)} of {len(rows)} rows took {sum(measured):.0f} s of processor time together."


def _write_markdown(content: Mapping[str, Any]) -> str:
    first, sections = content["first"], content["sections"]
    parts = [f"# {content['title']}", first["asked"], *(f"- {sentence}" for sentence in first["sentences"])]
    parts += [f"The study {name} could not be run: {why}" for name, why in content["failed"]]
    for question, names in content["groups"].items():
        parts.append(f"## {question}")
        for section in (sections[name] for name in names):
            tables = [Table("Statements", ["statement", "measured", "bound", "reached"], section["gates"])]
            if section["failed"]:
                tables.append(Table("What could not be measured", ["case", "method", "", "why"], section["failed"]))
            tables += [*section["tables"], section["rows"]]
            parts += [f"### {section['heading']}", section["words"], *map(to_markdown, tables)]
    parts += [to_markdown(Table("Where it was measured", PROVENANCE, content["provenance"])), content["cost"]]
    return "\n\n".join(part for part in parts if part) + "\n"
