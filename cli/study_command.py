"""`softdeca bench NAME`: a study's fields as options, its rows and gates as lines."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..lhm.base.errors import InputError
from .options import argument, list_options, make_option, option
from .terminal import show_progress
from .written_file import FOLDER

if TYPE_CHECKING:
    # It brings the surrogate with it, which most commands go without.
    from ..benchmarks.harness.runner import Results
    from ..benchmarks.harness.study import Study

WRITES = """Writes OUT/index.html, its figures as OUT/figure-1.svg and so on, OUT/results.json and, as rows come,
    OUT/rows.jsonl. Rows in OUT are kept. What failed is tried again. With PART only cases and methods that have it in
    their name are measured. Exit status 1 if a gate is missed or a case could not be measured."""


@dataclass(frozen=True)
class RunOptions:
    """The options of every run of a study; `judged`: whether a missed gate makes exit status 1."""

    match: str = argument("[PART]", "", type=str)
    out: Path | None = option(None, "folder of the report; default: out/ and the study's name", type=FOLDER)
    json: bool = option(False, "print the results file to stdout")

    def run_study(self, study: Study, folder: Path, *, judged: bool = True) -> int:
        """Run a study, print its rows and gates, and return the exit status."""
        from ..benchmarks.harness import run

        before = _read_options(folder)
        with show_progress() as progress:
            results = run(study, folder, match=self.match, progress=progress)
        if before not in (None, results.options):
            words = (
                "its page and results.json were of other options; their rows are kept, and come back with these options"
            )
            click.echo(f"softdeca: {folder}: {words}", err=True)
        if self.json:
            click.echo((folder / "results.json").read_text())
        else:
            print_results(study, results, folder)
        failed = any(row.status == "failed" for row in results.rows)
        return 1 if failed or (judged and not results.passed) else 0


def _read_options(folder: Path) -> Mapping[str, Any] | None:
    """Read the options of the results in a folder; None where there are none."""
    from ..benchmarks.harness.results import read_results

    with suppress(InputError):
        return read_results(folder).get("options")
    return None


RUN_OPTIONS = tuple(field.name for field in list_options(RunOptions))


def command_of_study(kind: type[Study], *, out: str = "", named: str = "", judged: bool = True) -> click.Command:
    """Make the command of a study, whose options are its fields made by `option`, and those of every run.

    out: the default folder, by default out/NAME. named: the field that is an argument, in place of an option. judged:
    whether a missed gate makes exit status 1, as a case that could not be measured does.
    """
    out = out or f"out/{kind.name}"

    def run(**values: Any) -> int:
        asked = RunOptions(**{name: values.pop(name) for name in RUN_OPTIONS if name in values})
        return asked.run_study(make_study(kind, values), asked.out or Path(out), judged=judged)

    params = [
        click.Argument([field.name]) if field.name == named else make_option(field) for field in list_options(kind)
    ]
    params += [
        make_option(field, **({"default": out} if field.name == "out" else {})) for field in list_options(RunOptions)
    ]
    text = f"""{kind.question}

    {WRITES}
    """
    # Click's own first sentence would end at "Eq."
    return click.Command(
        kind.name,
        params=params,
        callback=run,
        help=text,
        short_help=kind.question,
    )


def make_study(kind: type[Study], options: Mapping[str, Any]) -> Study:
    """Make a study of these options; InputError for an empty text and a number that is not finite."""
    for name, value in options.items():
        if isinstance(value, tuple) and "" in value:
            raise InputError(f"{name}: an empty text is none of them")
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{name}: expected a finite number, got {value}")
    return kind(**options)


def print_results(study: Study, results: Results, folder: Path) -> None:
    """Print rows, conclusion, gates and files of a study."""
    from ..benchmarks.harness.page import summarise_cell

    def short(value: Any) -> str:
        if isinstance(value, bool):
            return "yes" if value else "NO"
        return f"{value:.4g}" if isinstance(value, float) else str(value)

    skipped = Counter(row.reason for row in results.rows if row.status == "skipped")
    for reason, count in skipped.items():
        click.echo(f"SKIPPED {count} of {len(results.rows)}: {reason}")
    for row in results.rows:
        if row.status == "failed":
            click.echo(f"FAILED {row.case}, {row.method}: {row.reason}")
        for values in study.lines(row.values) if row.done else ():
            cells = ((column.title, summarise_cell(values.get(column.key))) for column in study.columns)
            figures = "  ".join(f"{title} {short(value)}" for title, value in cells if value not in (None, row.case))
            click.echo(f"{row.case}, {row.method}: {figures}")
    if results.words:
        click.echo(results.words)
    for gate in results.gates:
        click.echo(describe_gate(gate))
    for name in ("index.html", "results.json", "rows.jsonl"):
        click.echo(f"wrote {folder / name}")


def describe_gate(gate: Mapping) -> str:
    """Describe a gate in a line."""
    value = "not measured" if gate["value"] is None else f"{gate['value']:.3g}"
    return f"{'ok  ' if gate['passed'] else 'MISS'} {gate['what']}: {value} ({gate['bound']})"
