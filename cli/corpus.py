"""softdeca corpus: training corpora of simulated frames."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import click

from ..lhm.base.limits import PEOPLE as PEOPLE_BOUND
from ..lhm.base.limits import SEED, WORKERS
from .counts import counted
from .progress import shown
from .written_file import FOLDER, PNG

AFolder = click.Path(path_type=Path, file_okay=False)
AFile = click.Path(path_type=Path, dir_okay=False)
FEW = 10
JSON = click.option("--json", "as_json", is_flag=True, help="print the outcome as JSON")
LEVEL = click.option("--level", type=click.IntRange(1, 3), default=2, help="1,212, 4,842 or 19,362 vertices per wrap")
PEOPLE = click.option(
    "--identities",
    default="anny",
    help="whom: 'anny', 'ict:FILE', 'flame:FILE', 'folder:DIR', or 'external:ict:FILE' (ICT's in anny's triangles, "
    "with shapes of their own)",
)


@click.group()
def corpus() -> None:
    """Simulated frames of random people, materials, effects and expressions: what a surrogate learns from."""


def _plan(plan_file: Path | None, preset: str | None, takes: Path | None, identities_count: int | None):
    from ..surrogate.corpus.plan import CorpusPlan, read_plan

    if plan_file is not None and preset is not None:
        raise click.UsageError("a plan's file and --preset both say which plan; give one", click.get_current_context())
    plan = (
        CorpusPlan.of({"preset": "tiny" if preset is None else preset}) if plan_file is None else read_plan(plan_file)
    )
    plan = plan if takes is None else replace(plan, takes=str(takes))
    return plan if identities_count is None else replace(plan, identities=identities_count)


def _options(command):
    for option in (
        click.argument("plan_file", metavar="[PLAN.toml]", required=False, type=AFile),
        click.option("--preset", help="tiny (default), study, fresh, small, neutral or paper, in place of a file"),
        click.option("--takes", type=AFolder, help="folder of recorded takes (LiveLink CSV, JSON, weights.csv)"),
        click.option("--people", "count", type=counted(PEOPLE_BOUND), help="how many, in place of the plan's"),
        PEOPLE,
        LEVEL,
        JSON,
    ):
        command = option(command)
    return command


@corpus.command("plan")
@_options
@click.option("--out", type=AFolder, help="a corpus by this plan, begun already: its rate is used, not measured anew")
def plan_(plan_file, preset, takes, count, identities, level, as_json, out: Path | None) -> int:
    """What a corpus will hold and cost, by a rate measured on two people (a minute).

    PLAN.toml has `preset` and any field of the plan, such as identities = 640, groups = 4, frames = 9, sequences = 1,
    responses = 1.0, references = 5, varying = 0.5, seed = 1, and tables of shares [kinds] and [sources].
    """
    from ..surrogate.corpus.folder import Corpus
    from ..surrogate.corpus.manifest import read_manifest
    from ..surrogate.corpus.people import people_of
    from ..surrogate.corpus.predict import Rates, predicted, probe

    if out is not None:
        read_manifest(out)  # refuses what is no corpus, before a minute is spent
    with shown() as progress:
        plan = _plan(plan_file, preset, takes, count)
        people = people_of(identities, level=level, on_progress=progress)
        rates = None if out is None else Rates.of(Corpus(out, plan, people).status())
        if rates is None:
            progress("measuring a rate", 0.0)
            rates = probe(plan, people)
            progress("measuring a rate", 1.0)
    found = predicted(plan, len(people.mean.vertices), rates)
    if as_json:
        click.echo(json.dumps({"plan": plan.digest, "rates": asdict(rates), **asdict(found)}, indent=1))
        return 0
    click.echo(
        f"plan {plan.digest}: {found.people} people, {plan.tested} of them in test; {found.groups} parameter sets"
    )
    click.echo(
        f"{found.statics} static frames, {found.sequences} sequences of 16, derivatives of {found.responses} sets"
    )
    for split, pools in plan.pools.items():
        click.echo(f"recordings in {split}: " + ", ".join(f"{len(names)} {kind}" for kind, names in pools.items()))
    click.echo(
        f"{found.bytes / 1e9:.2f} GB, {found.bytes_per_frame / 1e3:.1f} kB a frame; {found.core_hours:.2f} core-hours"
    )
    return 0


@corpus.command()
@_options
@click.option("--out", default="out/corpus", type=FOLDER, help="folder of the corpus; what is done there is kept")
@click.option("--workers", type=counted(WORKERS), default=1, help="processes on this machine (embedded Dask cluster)")
@click.option(
    "--scheduler", metavar="ADDRESS", help="of an existing Dask cluster, as tcp://host:8786, in place of them"
)
def generate(plan_file, preset, takes, count, identities, level, as_json, out, workers, scheduler) -> int:
    """Simulate a corpus; run again, it goes on where it was stopped. Exit status 1 if more than 5 % is rejected."""
    with shown() as progress:
        return _generate(
            out, _plan(plan_file, preset, takes, count), identities, level, workers, scheduler, as_json, progress
        )


@corpus.command()
@click.argument("folder", type=AFolder)
@click.option("--workers", type=counted(WORKERS), default=1, help="processes on this machine (embedded Dask cluster)")
@click.option(
    "--scheduler", metavar="ADDRESS", help="of an existing Dask cluster, as tcp://host:8786, in place of them"
)
@JSON
def resume(folder: Path, workers: int, scheduler: str | None, as_json: bool) -> int:
    """Make what is missing or damaged in a corpus, by the plan that lies in it."""
    plan, made_with = _known(folder)
    with shown() as progress:
        return _generate(
            folder, plan, made_with["identities"], made_with["level"], workers, scheduler, as_json, progress
        )


def _known(folder: Path):
    """A corpus' plan, and with what it was made."""
    from ..surrogate.corpus.folder import known_plan

    return known_plan(folder)


def _generate(out, plan, identities, level, workers, scheduler, as_json, progress) -> int:
    from ..lhm.base.provenance import describe_machine
    from ..surrogate.corpus.card import write_card
    from ..surrogate.corpus.folder import Corpus
    from ..surrogate.corpus.people import people_of
    from ..surrogate.schedule import check_answers, schedule

    on = schedule(workers, scheduler)
    check_answers(on)
    people = people_of(identities, level=level, on_progress=progress)
    made_with = {"identities": identities, "level": level}
    status = Corpus(out, plan, people, made_with).generate(on=on, on_progress=progress)
    write_card(Corpus(out, plan, people, made_with), machine=describe_machine())
    _tell(status, out, as_json)
    return 0 if status.rejected_share <= 0.05 and not status.damaged else 1


def _tell(status, folder: Path, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(asdict(status), indent=1))
        return
    click.echo(f"{folder}: {status.identities_done} of {status.identities} people, {status.bytes / 1e9:.2f} GB")
    for table, asked in status.asked.items():
        click.echo(f"  {table}: {status.accepted[table]} accepted of {asked}")
    for message in status.damaged:
        click.echo(f"DAMAGED {message}")
    reasons: dict[str, int] = {}
    for rejection in status.rejected:
        reasons[rejection.reason] = reasons.get(rejection.reason, 0) + 1
    for reason, count in sorted(reasons.items(), key=lambda item: -item[1])[:FEW]:
        click.echo(f"  rejected {count} times: {reason}")
    if len(reasons) > FEW:
        click.echo(f"  and for {len(reasons) - FEW} other reasons; --json lists all")


@corpus.command()
@click.argument("folder", type=AFolder)
@JSON
def status(folder: Path, as_json: bool) -> int:
    """What a corpus holds, what was rejected and why, and which shards are damaged. Exit status 1 until it is whole."""
    from ..surrogate.corpus.folder import status_of
    from ..surrogate.corpus.manifest import read_manifest

    manifest = read_manifest(folder)
    found = status_of(folder, manifest.counts, manifest.owner)
    _tell(found, folder, as_json)
    return 0 if found.identities_done == found.identities and not found.damaged else 1


@corpus.command()
@click.argument("folder", type=AFolder)
def verify(folder: Path) -> int:
    """Read every shard of a corpus and check it; the first that is missing, damaged or swapped is named.

    FOLDER may be a study's own corpus, OUT/surrogate/corpus-... of `softdeca study`, as for `status`.
    """
    from ..surrogate.corpus.folder import verify_folder

    with shown() as progress:
        people = verify_folder(folder, on_progress=progress)
    click.echo(f"{folder}: {people} shards are whole")
    return 0


@corpus.command()
@click.argument("folder", type=AFolder)
@click.option("--count", type=click.IntRange(1, 200), default=12, help="frames")
@click.option("--seed", type=counted(SEED), default=0, help="of the choice")
@click.option("--out", type=PNG, help="default: FOLDER/sample.png")
def sample(folder: Path, count: int, seed: int, out: Path | None) -> int:
    """A contact sheet of random accepted frames: blendshapes S, simulation T, and |T - S| as colours."""
    from ..animation.contact_sheet import draw_contact_sheet
    from ..lhm.base.files.atomic import write_whole

    out = folder / "sample.png" if out is None else out
    with shown() as progress:
        write_whole(out, draw_contact_sheet(folder, count, seed, progress))
    click.echo(out)
    return 0
