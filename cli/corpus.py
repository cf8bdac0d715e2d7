"""softdeca corpus: training corpora of simulated frames."""

import json
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..lhm.base.errors import InputError
from ..lhm.base.limits import PEOPLE, SEED
from ..lhm.base.progress import OnProgress
from .counts import counted
from .study_command import option_of
from .terminal import show_progress
from .written_file import FOLDER, PNG

if TYPE_CHECKING:
    from ..surrogate.corpus.folder import CorpusStatus
    from ..surrogate.corpus.plan import CorpusPlan

AFolder = click.Path(path_type=Path, file_okay=False)
AFile = click.Path(path_type=Path, dir_okay=False)
FEW = 10
"""Reasons that are listed."""


@dataclass(frozen=True)
class Generation:
    """The options of `softdeca corpus generate`; None leaves a choice to the folder's own corpus or the plan."""

    preset: str | None = field(
        default=None,
        metadata={"type": str, "help": "tiny (default), study, fresh, small, neutral or paper, in place of a file"},
    )
    takes: Path | None = field(
        default=None, metadata={"type": AFolder, "help": "folder of recorded takes (LiveLink CSV, JSON, weights.csv)"}
    )
    people: int | None = field(
        default=None, metadata={"type": counted(PEOPLE), "help": "how many, in place of the plan's"}
    )
    identities: str | None = field(
        default=None,
        metadata={
            "type": str,
            "help": "people: 'anny' (default), 'ict:FILE', 'flame:FILE', 'folder:DIR', 'external:ict:FILE' (ICT's in "
            "anny's triangles, with shapes of their own), or 'spheres:N' (of fineness N, for trials)",
        },
    )
    level: int | None = field(
        default=None,
        metadata={"type": click.IntRange(1, 3), "help": "1,212, 4,842 (default) or 19,362 vertices per wrap"},
    )
    out: Path = field(default=Path("out/corpus"), metadata={"type": FOLDER, "help": "folder of the corpus"})
    workers: int = field(default=1, metadata={"help": "processes on this machine (embedded Dask cluster)"})
    scheduler: str | None = field(
        default=None,
        metadata={
            "type": str,
            "metavar": "ADDRESS",
            "help": "of an existing Dask cluster, as tcp://host:8786",
        },
    )
    dry_run: bool = field(
        default=False, metadata={"help": "print what the corpus will hold and cost, by a rate measured in a minute"}
    )
    as_json: bool = field(default=False, metadata={"option": "--json", "help": "print the outcome as JSON"})

    def plan(self, file: Path | None) -> "tuple[CorpusPlan, dict]":
        """The plan, and with what people are made: of the file or preset, or of the corpus that lies in `out`."""
        from ..surrogate.corpus.folder import read_kept_plan
        from ..surrogate.corpus.manifest import MANIFEST, read_manifest
        from ..surrogate.corpus.plan import CorpusPlan, read_plan

        if file is not None and self.preset is not None:
            context = click.get_current_context()
            raise click.UsageError("a plan's file and --preset both say which plan; give one", context)
        kept = dict(read_manifest(self.out).made_with) if (self.out / MANIFEST).exists() else {}
        asked = {"identities": self.identities, "level": self.level}
        for name, value in asked.items():
            if value is not None and kept.get(name, value) != value:
                raise InputError(
                    f"{self.out}: holds a corpus of another {name} ({kept[name]}, expected {value}); use another folder"
                )
        made_with = {
            name: kept.get(name, usual) if asked[name] is None else asked[name]
            for name, usual in (("identities", "anny"), ("level", 2))
        }
        if file is None and self.preset is None and (self.out / MANIFEST).exists():
            plan, _ = read_kept_plan(self.out)
        else:
            plan = (
                CorpusPlan.of({"preset": "tiny" if self.preset is None else self.preset})
                if file is None
                else read_plan(file)
            )
        plan = plan if self.takes is None else replace(plan, takes=str(self.takes))
        return plan if self.people is None else replace(plan, identities=self.people), made_with

    def foretell(self, plan: "CorpusPlan", made_with: dict, progress: OnProgress) -> None:
        """Print what a plan comes to, by the rate of the corpus that lies in `out`, or of two people."""
        from ..surrogate.corpus.folder import Corpus
        from ..surrogate.corpus.people import people_from_text
        from ..surrogate.corpus.predict import Rates, measure_rates, predict_cost

        people = people_from_text(made_with["identities"], level=made_with["level"], on_progress=progress)
        rates = Rates.of(Corpus(self.out, plan, people).status())
        if rates is None:
            progress("measuring a rate", 0.0)
            rates = measure_rates(plan, people)
            progress("measuring a rate", 1.0)
        cost = predict_cost(plan, len(people.mean.vertices), rates)
        if self.as_json:
            click.echo(json.dumps({"plan": plan.digest, "rates": asdict(rates), **asdict(cost)}, indent=1))
            return
        click.echo(
            f"plan {plan.digest}: {cost.people} people, {plan.tested} of them in test; {cost.groups} parameter sets"
        )
        click.echo(
            f"{cost.statics} static frames, {cost.sequences} sequences of 16, derivatives of {cost.responses} sets"
        )
        for split, pools in plan.pools.items():
            click.echo(f"recordings in {split}: " + ", ".join(f"{len(names)} {kind}" for kind, names in pools.items()))
        click.echo(
            f"{cost.bytes / 1e9:.2f} GB, {cost.bytes_per_frame / 1e3:.1f} kB a frame; {cost.core_hours:.2f} core-hours"
        )

    def make(self, plan: "CorpusPlan", made_with: dict, progress: OnProgress) -> "CorpusStatus":
        """Simulate what is missing in `out`."""
        from ..lhm.base.provenance import describe_machine
        from ..surrogate.corpus.card import write_card
        from ..surrogate.corpus.folder import Corpus
        from ..surrogate.corpus.people import people_from_text
        from ..surrogate.schedule import check_scheduler, make_schedule

        on = make_schedule(self.workers, self.scheduler)
        check_scheduler(on)
        people = people_from_text(made_with["identities"], level=made_with["level"], on_progress=progress)
        corpus = Corpus(self.out, plan, people, made_with)
        status = corpus.generate(on=on, on_progress=progress)
        write_card(corpus, machine=describe_machine())
        return status


@click.group()
def corpus() -> None:
    """Simulated frames of random people, materials, effects and expressions: what a surrogate learns from."""


def _generate(plan_file: Path | None, **options) -> int:
    """Simulate a corpus; run again, it resumes, by the plan that lies in OUT if no other is given.

    PLAN.toml has `preset` and any field of the plan, such as identities = 640, groups = 4, frames = 9, sequences = 1,
    responses = 1.0, references = 5, varying = 0.5, seed = 1, and tables of shares [kinds] and [sources].

    A corpus of another plan in OUT is refused, and what differs is named. Exit status 1 if more than 5 % is rejected.
    """
    generation = Generation(**options)
    with show_progress() as progress:
        plan, made_with = generation.plan(plan_file)
        if generation.dry_run:
            generation.foretell(plan, made_with, progress)
            return 0
        status = generation.make(plan, made_with, progress)
    _tell(status, generation.out, generation.as_json)
    return 0 if status.rejected_share <= 0.05 and not status.damaged else 1


corpus.add_command(
    click.Command(
        "generate",
        params=[
            click.Argument(["plan_file"], metavar="[PLAN.toml]", required=False, type=AFile),
            *map(option_of, fields(Generation)),
        ],
        callback=_generate,
        help=_generate.__doc__,
    )
)


def _tell(status: "CorpusStatus", folder: Path, as_json: bool) -> None:
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


class CorpusFolder(click.Path):
    """The folder of a corpus, or of a `softdeca study`, whose own corpus is meant then."""

    name = "folder"

    def __init__(self):
        super().__init__(path_type=Path, file_okay=False)

    def convert(self, value, param, ctx):
        """The corpus' folder; InputError where a study has several."""
        folder = Path(str(super().convert(value, param, ctx)))
        own = sorted(path.parent for path in folder.glob("surrogate/corpus-*/corpus.json"))
        if (folder / "corpus.json").exists() or not own:
            return folder
        if len(own) > 1:
            raise InputError(f"{folder}: a study with {len(own)} corpora; give one, as {own[0]}")
        return own[0]


@corpus.command()
@click.argument("folder", type=CorpusFolder())
@click.option("--json", "as_json", is_flag=True, help="print the outcome as JSON")
def status(folder: Path, as_json: bool) -> int:
    """Count what a corpus holds, what was rejected and why; name damaged shards. Exit status 1 until it is whole.

    FOLDER is a corpus, or the folder of a `softdeca study`, whose own corpus is meant then.
    """
    from ..surrogate.corpus.folder import read_status
    from ..surrogate.corpus.manifest import read_manifest

    manifest = read_manifest(folder)
    counted_status = read_status(folder, manifest.counts, manifest.owner)
    _tell(counted_status, folder, as_json)
    whole = counted_status.identities_done == counted_status.identities and not counted_status.damaged
    return 0 if whole else 1


@corpus.command()
@click.argument("folder", type=CorpusFolder())
def verify(folder: Path) -> int:
    """Read every shard of a corpus and check it; the first that is missing, damaged or swapped is named.

    FOLDER is a corpus, or the folder of a `softdeca study`.
    """
    from ..surrogate.corpus.folder import verify_folder

    with show_progress() as progress:
        people = verify_folder(folder, on_progress=progress)
    click.echo(f"{folder}: {people} shards are whole")
    return 0


@corpus.command()
@click.argument("folder", type=CorpusFolder())
@click.option("--count", type=click.IntRange(1, 200), default=12, help="frames")
@click.option("--seed", type=counted(SEED), default=0, help="random seed of the choice")
@click.option("--out", type=PNG, help="default: FOLDER/sample.png")
def sample(folder: Path, count: int, seed: int, out: Path | None) -> int:
    """Draw random accepted frames on one sheet: blendshapes S, simulation T, and |T - S| as colours.

    FOLDER is a corpus, or the folder of a `softdeca study`.
    """
    from ..animation.contact_sheet import draw_contact_sheet
    from ..lhm.base.files.atomic import write_whole

    out = folder / "sample.png" if out is None else out
    with show_progress() as progress:
        write_whole(out, draw_contact_sheet(folder, count, seed, progress))
    click.echo(out)
    return 0
