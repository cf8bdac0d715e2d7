"""`softdeca bench NAME` of a study: its fields as options, its rows and gates as lines."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import Field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..benchmarks.studies import SUBJECTS, commands, names, study_of
from ..lhm.base.errors import InputError
from ..lhm.base.limits import FACES, SEED, STUDIED_PAIRS, WORKERS, Bound
from .counts import counted
from .terminal import show_progress
from .written_file import WrittenFolder

if TYPE_CHECKING:
    # It brings the surrogate with it, which most commands go without.
    from ..benchmarks.harness.runner import Results
    from ..benchmarks.harness.study import Study

COUNTS: dict[str, Bound] = {
    "seed": SEED,
    "level": Bound("level", 3, "templates have three", 1),
    "repeats": Bound("repeats", 1_000, "medians of fewer are as good", 1),
    "rounds": Bound("rounds", 1_000, "medians of fewer are as good", 1),
    "people": Bound("people", 1_000, "each is minutes of work", 1),
    "frames": Bound("frames", 100_000, "each is 0.1 s of work or more", 1),
    "count": Bound("identities", 100_000, "each is a second of work or more", 1),
    "gallery": Bound("heads", 1_000, "each is simulated and drawn"),
    "fan": Bound("starts", 1_000, "each is a solve"),
    "simulated": FACES,
    "generalisation": replace(STUDIED_PAIRS, least=0),
    "workers": WORKERS,
    "up_to": Bound("unknowns", 100_000_000, "a machine of 64 GB holds some ten million", 1),
}
"""The bound of a study's option by its field's name; where a study itself takes less, it says so."""
ONLY = ("missing", "failed", "all")
WRITES = """Writes OUT/index.html, OUT/results.json and, as rows come, OUT/rows.jsonl. Rows in OUT are kept.
    Exit status 1 if a gate is missed or a case could not be measured."""


def gate_line(gate: dict) -> str:
    """A gate as a line."""
    value = "not measured" if gate["value"] is None else f"{gate['value']:.3g}"
    return f"{'ok  ' if gate['passed'] else 'MISS'} {gate['what']}: {value} ({gate['bound']})"


class Studies(click.Group):
    """A group with a command for each study, made when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Subjects, studies, and what else was added."""
        return sorted({*commands(), *super().list_commands(ctx)})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The command of a subject, of a study, or another."""
        if name in SUBJECTS:
            return command_of_cases(name)
        return command_of(study_of(name)) if name in commands() else super().get_command(ctx, name)


@click.command("list")
def listed() -> int:
    """List the studies with their questions; those of one subject are its --cases."""

    def show(name: str, study: str) -> None:
        kind = study_of(study)
        click.echo(f"{name:<16} {kind.heading or kind.question}")

    for name in commands():
        if name not in SUBJECTS:
            show(name, name)
            continue
        question, cases = SUBJECTS[name]
        click.echo(f"{name:<16} {question}")
        for case, study in cases.items():
            show(f"  {case}", study)
    return 0


@click.command("compare")
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path))
def changes(before: Path, after: Path) -> int:
    """Compare two results of one study: costs and answers that changed by more than noise, and what one has not done.

    BEFORE and AFTER are folders of a study, or their results.json. Exit status 1 if a cost rose, a task is not done any
    more, or a statement not reached.
    """
    from ..benchmarks.harness.results import compared, study_in

    name = study_in(before)
    if name not in names():
        raise InputError(f"{before}: of a study {name!r}, which there is not")
    found = compared(before, after, study_of(name))
    told = [change for change in found.changes if change.told]
    for change in told:
        click.echo(f"{change.share:+8.1%}  {change.task}, {change.what}: {change.before:.4g} -> {change.after:.4g}")
    for line in [*found.broken, *found.other]:
        click.echo(line)
    for what, cost in (("answers", False), ("costs", True)):
        count = sum(change.cost is cost for change in found.changes)
        changed = sum(change.cost is cost for change in told)
        click.echo(f"{count - changed} of {count} {what} are the same within noise")
    return 1 if found.broken or any(change.cost and change.share > 0 for change in told) else 0


@click.command("report")
@click.argument("results", nargs=-1, type=click.Path(path_type=Path))
@click.option("--title", default="the fast simulator, finite elements and the network", help="of the page")
@click.option("--out", type=WrittenFolder(), default="out/report", help="folder of the report")
def report(results: tuple[Path, ...], title: str, out: Path) -> int:
    """One report of many studies: OUT/index.html, report.md, report.json and tables.tex (booktabs).

    RESULTS are folders of studies, or their results.json; by default all folders in `out` that hold one.
    """
    from ..benchmarks.harness.report import read, write

    asked = results or tuple(folder for name in names() if (folder := Path("out") / name / "results.json").is_file())
    if not asked:
        raise InputError("report: no results in out/; run a study first, as `softdeca bench verification`")
    for path in write([read(path, study_of) for path in asked], out, title):
        click.echo(f"wrote {path}")
    return 0


def command_of(kind: type[Study], *, out: str = "", argument: str = "", judged: bool = True) -> click.Command:
    """Make the command of a study, whose options are its fields and those of every run.

    out: the default folder, by default out/NAME. argument: the field that is one, in place of an option. judged:
    whether a missed gate makes exit status 1, as a case that could not be measured does.
    """
    own: list[click.Parameter] = [
        click.Argument([field.name]) if field.name == argument else option_of(field)
        for field in fields(kind)  # type: ignore[arg-type]  # every study is a dataclass
    ]

    def run(match: str, only: Any, workers: int | None, out: Path, as_json: bool, **options: Any) -> int:
        return _status(_run(_study(kind, options), match, only, workers, out, as_json), judged)

    text = f"""{kind.question}

    {WRITES}
    """
    params = [*own, *_run_options(out or f"out/{kind.name}")]
    # Click's own first sentence would end at "Eq."
    return click.Command(kind.name, params=params, callback=run, help=text, short_help=kind.question)


def _status(results: Results, judged: bool = True) -> int:
    failed = any(row.status == "failed" for row in results.rows)
    return 1 if failed or (judged and not results.passed) else 0


def command_of_cases(subject: str) -> click.Command:
    """The command of several studies of one subject; --cases says which, and each takes the options that it has."""
    question, cases = SUBJECTS[subject]
    kinds = {case: study_of(name) for case, name in cases.items()}
    held: dict[str, dict[str, Field]] = {}
    for case, kind in kinds.items():
        for field in fields(kind):  # type: ignore[arg-type]
            held.setdefault(_option_name(field), {})[case] = field
    own = [_shared_option(name, of, len(kinds)) for name, of in held.items()]
    text = f"all, or some of {','.join(kinds)}; default: {next(iter(kinds))}"
    which = click.Option(["--cases"], default=next(iter(kinds)), show_default=False, help=text)

    def run(
        cases: str, match: str, only: Any, workers: int | None, out: Path | None, as_json: bool, **options: Any
    ) -> int:
        chosen = list(kinds) if cases == "all" else cases.split(",")
        for case in chosen:
            if case not in kinds:
                raise click.UsageError(f"--cases {case}: expected all, or some of {', '.join(kinds)}")
        given = {p.name: p for p in own if options[p.name] not in (None, ()) and options[p.name] is not False}
        for parameter in given.values():
            having = held[parameter.opts[0]]
            if not having.keys() & set(chosen):
                raise click.UsageError(f"{parameter.opts[0]}: an option of --cases {','.join(having)}")
        if as_json and len(chosen) > 1:
            raise click.UsageError("--json: results of one case only")
        studies = []
        for case in chosen:
            values = {
                held[p.opts[0]][case].name: _as_field(held[p.opts[0]][case], options[p.name], p)
                for p in given.values()
                if case in held[p.opts[0]]
            }
            for name, of in held.items():
                if case in of and of[case].metadata.get("required") and of[case].name not in values:
                    raise click.UsageError(f"--cases {case}: {name} is missing")
            studies.append(_study(kinds[case], values))
        folders = [
            Path("out") / study.name if out is None else out / case if len(chosen) > 1 else out
            for case, study in zip(chosen, studies, strict=True)
        ]
        ends = [
            _status(_run(study, match, only, workers, folder, as_json))
            for study, folder in zip(studies, folders, strict=True)
        ]
        return max(ends)

    lines = "\n".join(f"    {case}: {kind.heading or kind.question}\n" for case, kind in kinds.items())
    text = f"""{question}

{lines}
    {WRITES} Several cases: OUT/CASE.
    """
    return click.Command(
        subject, params=[which, *own, *_run_options(None)], callback=run, help=text, short_help=question
    )


def _run_options(out: str | None) -> list[click.Option]:
    """The options of every run."""
    where = "folder of the report" + ("; default: out/ and the study's name" if out is None else "")
    return [
        click.Option(["--match"], default="", help="only cases and methods with this in their name"),
        click.Option(["--only"], type=click.Choice(ONLY), default="missing", help="which to do: failed again, or all"),
        click.Option(["--workers"], type=counted(WORKERS), help="processes; default: all; one if timed"),
        click.Option(["--out"], type=WrittenFolder(), default=out, help=where),
        click.Option(["--json", "as_json"], is_flag=True, help="print the results file to stdout"),
    ]


def _study(kind: type[Study], options: Mapping[str, Any]) -> Study:
    """The study of these options; InputError for an empty text and a number that is not finite."""
    for name, value in options.items():
        if isinstance(value, tuple) and "" in value:
            raise InputError(f"{name}: an empty text is none of them")
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{name}: expected a finite number, got {value}")
    return kind(**options)


def _option_name(field: Field) -> str:
    plain = "--" + field.name.replace("_", "-")
    name: str = field.metadata.get("option", plain.removesuffix("s") if isinstance(field.default, tuple) else plain)
    return name


def option_of(field: Field) -> click.Option:
    """Make the option of a dataclass' field: its type by the default, its words by the metadata."""
    return _option([field])


def _kind_of(field: Field) -> Any:
    """The click type of an option's values."""
    is_count = field.name in COUNTS and type(field.default) is int
    return field.metadata.get("type", counted(COUNTS[field.name]) if is_count else type(field.default))


def _option(of: Sequence[Field], **words: Any) -> click.Option:
    """The option of a field; of several cases' fields one that takes what each of them does."""
    field = of[0]
    words = {key: value for key, value in field.metadata.items() if key != "option"} | words
    if "default" not in words and not words.get("required"):
        words["default"] = field.default
    names = [_option_name(field), field.name]
    if field.default is False:
        return click.Option(names, is_flag=True, **words)
    if any(isinstance(each.default, tuple) for each in of):
        return click.Option(names, multiple=True, **words)
    words["type"] = _kind_of(field)
    return click.Option(names, **words)


def _shared_option(name: str, of: Mapping[str, Field], count: int) -> click.Option:
    """An option of some cases, without a value where it is not given, so that each case has its own default."""
    several = list(of.values())
    default: Any = () if any(isinstance(field.default, tuple) for field in several) else None
    words = str(several[0].metadata.get("help", ""))
    words += "" if len(of) == count else f" ({', '.join(of)})"
    if several[0].default is False:
        return _option(several, default=False, help=words)
    usual = {field.default for field in several}
    if len(usual) == 1 and usual != {""} and usual != {()}:
        value = several[0].default
        words += f"  [{', '.join(value) if isinstance(value, tuple) else value}]"
    return _option(several, default=default, required=False, show_default=False, help=words)


def _as_field(field: Field, value: Any, option: click.Parameter) -> Any:
    """An option's value as this field has it: one text of several cases' repeated ones becomes a number."""
    if isinstance(value, tuple) and not isinstance(field.default, tuple):
        return click.types.convert_type(_kind_of(field)).convert(value[-1], option, None)
    return value


def _run(study: Study, match: str, only: Any, workers: int | None, out: Path, as_json: bool) -> Results:
    from ..benchmarks.harness import run
    from ..benchmarks.harness.page import one as cell

    with show_progress() as progress:
        results = run(study, out, only=only, workers=workers, match=match, progress=progress)
    if as_json:
        click.echo((out / "results.json").read_text())
        return results
    skipped = Counter(row.reason for row in results.rows if row.status == "skipped")
    for reason, count in skipped.items():
        click.echo(f"SKIPPED {count} of {len(results.rows)}: {reason}")
    for row in results.rows:
        if row.status == "failed":
            click.echo(f"FAILED {row.case}, {row.method}: {row.reason}")
        if not row.done:
            continue
        for values in study.lines(row.values):
            said = ((column.title, cell(values.get(column.key))) for column in study.columns)
            figures = "  ".join(f"{title} {_short(value)}" for title, value in said if value not in (None, row.case))
            click.echo(f"{row.case}, {row.method}: {figures}")
    if results.words:
        click.echo(results.words)
    for gate in results.gates:
        click.echo(gate_line(gate))
    for name in ("index.html", "results.json", "rows.jsonl"):
        click.echo(f"wrote {out / name}")
    return results


def _short(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "NO"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
