"""softdeca corpus: training corpora of simulated frames."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..lhm.base.errors import InputError
from ..lhm.base.limits import PEOPLE, WORKERS
from ..lhm.base.progress import OnProgress, describe_duration
from .options import LEVEL, argument, as_command, count_range, option, refuse_unread
from .terminal import show_progress
from .written_file import FOLDER, PNG

if TYPE_CHECKING:
    from ..surrogate.corpus.folder import CorpusStatus
    from ..surrogate.corpus.plan import CorpusPlan

FEW = 10
"""Reasons that are listed."""


class CorpusFolder(click.Path):
    """The folder of a corpus, or of a `softdeca study`, whose own corpus is meant then."""

    name = "folder"

    def __init__(self):
        super().__init__(path_type=Path, file_okay=False)

    def convert(self, value, param, ctx):
        """Give the corpus' folder; InputError where a study has several."""
        folder = Path(str(super().convert(value, param, ctx)))
        corpora = sorted(path.parent for path in folder.glob("surrogate/corpus-*/corpus.json"))
        if (folder / "corpus.json").exists() or not corpora:
            return folder
        if len(corpora) > 1:
            raise InputError(f"{folder}: a study with {len(corpora)} corpora; give one, as {corpora[0]}")
        return corpora[0]


@click.group()
def corpus() -> None:
    """Simulated frames of random people, materials, effects and expressions: what a surrogate learns from."""


@as_command(corpus, "generate")
@dataclass(frozen=True)
class Generate:
    """Simulate a corpus; run again, it resumes, by the plan that lies in OUT if no other is given.

    PLAN.toml has `preset` and any field of the plan, such as identities = 640, groups = 4, frames = 9, sequences = 1,
    responses = 1.0, references = 0, varying = 0.5, seed = 1, and tables of shares [kinds] and [sources].

    A corpus of another plan in OUT is refused, and what differs is named; so are files of another corpus. Exit status 1
    if more than 5 % is rejected, or a person is not there at the end.
    """

    # None leaves a choice to the folder's own corpus or the plan.
    plan_file: Path | None = argument("[PLAN.toml]", None, type=click.Path(path_type=Path, dir_okay=False))
    preset: str | None = option(
        None,
        "in place of a file: tiny (default); small, contact, faces or paper to learn from; study, fresh, moving or "
        "external to test on",
        type=str,
    )
    takes: Path | None = option(
        None,
        "folder of recorded takes (LiveLink CSV, MediaPipe's results, weights.csv, JSON)",
        type=click.Path(path_type=Path, file_okay=False),
    )
    people: int | None = option(None, "how many, in place of the plan's", type=count_range(PEOPLE))
    identities: str | None = option(
        None,
        "people: 'anny' (default), 'ict:FILE', 'flame:FILE', 'folder:DIR', 'external:ict:FILE' (ICT's in anny's "
        "triangles, with shapes of their own), or 'spheres:N' (of fineness N, for trials)",
        type=str,
    )
    level: int | None = option(None, "1,212, 4,842 (default) or 19,362 vertices per wrap", type=LEVEL)
    out: Path = option("out/corpus", "folder of the corpus", type=FOLDER)
    workers: int = option(1, "processes on this machine (embedded Dask cluster)", bound=WORKERS)
    scheduler: str | None = option(None, "an existing Dask cluster, as tcp://host:8786", type=str, metavar="ADDRESS")
    dry_run: bool = option(False, "print what the corpus will hold and cost, by the rate of a person simulated here")
    json: bool = option(False, "print the outcome as JSON")

    def run(self) -> int:
        """Simulate what is missing, or foretell it."""
        from ..lhm.base.provenance import describe_machine
        from ..surrogate.corpus.card import write_card
        from ..surrogate.corpus.folder import Corpus
        from ..surrogate.corpus.people import people_from_text
        from ..surrogate.corpus.schedule import check_scheduler, make_schedule

        plan, made_with = self._plan()
        self._check(made_with["identities"])
        with show_progress() as progress:
            if not self.dry_run:
                on = make_schedule(self.workers, self.scheduler)
                check_scheduler(on)
            people = people_from_text(made_with["identities"], level=made_with["level"], on_progress=progress)
            corpus = Corpus.from_plan(self.out, plan, people, made_with)
            if self.dry_run:
                self._foretell(corpus, progress)
                return 0
            status = corpus.generate(on=on, on_progress=progress)
            write_card(corpus, machine=describe_machine())
        print_status(status, self.out, self.json)
        return 0 if status.rejected_share <= 0.05 and not status.damaged else 1

    def _check(self, identities: str) -> None:
        """UsageError for options that contradict, or that nothing would read."""
        if identities.startswith("spheres:"):
            refuse_unread(self, "for spheres, whose fineness is their number", "level")
        if self.dry_run:
            refuse_unread(self, "in a dry run", "workers", "scheduler")
        if self.scheduler is not None:
            refuse_unread(self, "with --scheduler, which has its own", "workers")

    def _plan(self) -> tuple[CorpusPlan, dict]:
        """The plan, and with what people are made: of the file or preset, or of the corpus that lies in `out`."""
        from ..surrogate.corpus.folder import Corpus
        from ..surrogate.corpus.manifest import MANIFEST
        from ..surrogate.corpus.plan import CorpusPlan, read_plan

        if self.plan_file is not None and self.preset is not None:
            context = click.get_current_context()
            raise click.UsageError("a plan's file and --preset both say which plan; give one", context)
        there = Corpus.open(self.out) if (self.out / MANIFEST).exists() else None
        kept = {} if there is None else there.made_with
        made_with = {}
        for name, asked, usual in (("identities", self.identities, "anny"), ("level", self.level, 2)):
            if asked is not None and kept.get(name, asked) != asked:
                raise InputError(
                    f"{self.out}: holds a corpus of another {name} ({kept[name]}, expected {asked}); use another folder"
                )
            made_with[name] = kept.get(name, usual) if asked is None else asked
        if self.plan_file is not None:
            plan = read_plan(self.plan_file)
        elif self.preset is None and there is not None:
            plan = there.find_plan()
        elif self.preset is None and any(self.out.glob("person-*.h5")):
            raise InputError(
                f"{self.out}: shards of a corpus without its {MANIFEST}; give the PLAN.toml and the --identities that "
                "made them, or use another folder"
            )
        else:
            plan = CorpusPlan.of({"preset": "tiny" if self.preset is None else self.preset})
        plan = plan if self.takes is None else replace(plan, takes=str(self.takes))
        return plan if self.people is None else replace(plan, identities=self.people), made_with

    def _foretell(self, corpus, progress: OnProgress) -> None:
        """Print what a plan comes to, by the rate of the corpus that lies in `out`, or of a person."""
        from ..surrogate.corpus.predict import Spent, predict_cost, probe

        plan, spent = corpus.plan, Spent.of(corpus.status())
        if spent is None:
            progress("measuring a rate", 0.0)
            spent = probe(plan, corpus.people)
            progress("measuring a rate", 1.0)
        cost = predict_cost(plan, len(corpus.mean.vertices), spent)
        if self.json:
            click.echo(json.dumps({"plan": plan.digest, "spent": asdict(spent), **asdict(cost)}, indent=1))
            return
        lines = [
            f"plan {plan.digest}: {cost.people} people, {plan.tested} of them in test; {cost.groups} parameter sets",
            f"{cost.statics} static frames, {cost.sequences} sequences of 16, derivatives of {cost.responses} sets",
        ]
        for split, pools in plan.pools.items():
            lines.append(
                f"recordings in {split}: " + ", ".join(f"{len(names)} {kind}" for kind, names in pools.items())
            )
        size = f"{cost.bytes / 1e9:.2f} GB, {cost.bytes_per_frame / 1e3:.1f} kB a frame"
        hours = f"{cost.core_hours:.2f} core-hours"
        if cost.hours is not None:
            hours += f"; by one worker {describe_duration(3600.0 * cost.hours)} on this machine, as busy as it is now"
        for line in (*lines, f"{size}; {hours}"):
            click.echo(line)


@as_command(corpus, "status")
@dataclass(frozen=True)
class ShowStatus:
    """Count what a corpus holds, what was rejected and why; name damaged shards. Exit status 1 until it is whole.

    Every shard is read whole: some ten seconds for the 5 GB of `small`.

    FOLDER is a corpus, or the folder of a `softdeca study`, whose own corpus is meant then.
    """

    folder: Path = argument("FOLDER", type=CorpusFolder())
    json: bool = option(False, "print the outcome as JSON")

    def run(self) -> int:
        """Count and print."""
        from ..surrogate.corpus.folder import Corpus

        with show_progress() as progress:
            status = Corpus.open(self.folder).status(on_progress=progress)
        print_status(status, self.folder, self.json)
        return 0 if status.identities_done == status.identities and not status.damaged else 1


@as_command(corpus, "verify")
@dataclass(frozen=True)
class Verify:
    """Read every shard of a corpus and check it; the first that is missing, damaged, swapped or implausible is named.

    Some frames are simulated again, to see that they come out as they are kept, and that lids and lips do not cross.

    FOLDER is a corpus, or the folder of a `softdeca study`.
    """

    folder: Path = argument("FOLDER", type=CorpusFolder())

    def run(self) -> int:
        """Read all, and simulate some."""
        from ..surrogate.corpus.again import simulate_again
        from ..surrogate.corpus.folder import Corpus

        corpus = Corpus.open(self.folder)
        with show_progress() as progress:
            people = corpus.verify(on_progress=progress)
            frames = simulate_again(corpus, on_progress=progress)
        click.echo(f"{self.folder}: {people} shards are whole; {frames} frames come out the same when simulated again")
        return 0


@as_command(corpus, "sample")
@dataclass(frozen=True)
class DrawSample:
    """Draw random accepted frames on one sheet: blendshapes S, simulation T, and |T - S| as colours.

    FOLDER is a corpus, or the folder of a `softdeca study`.
    """

    folder: Path = argument("FOLDER", type=CorpusFolder())
    count: int = option(12, "frames", type=click.IntRange(1, 200))
    out: Path | None = option(None, "default: FOLDER/sample.png", type=PNG)

    def run(self) -> int:
        """Draw and write."""
        from ..animation.contact_sheet import draw_contact_sheet
        from ..lhm.base.files.atomic import write_whole

        out = self.folder / "sample.png" if self.out is None else self.out
        with show_progress() as progress:
            write_whole(out, draw_contact_sheet(self.folder, self.count, progress))
        click.echo(out)
        return 0


def print_status(status: CorpusStatus, folder: Path, as_json: bool) -> None:
    """Print what a corpus holds, and the commonest reasons of rejections."""
    from ..surrogate.corpus.folder import shorten_reason

    if as_json:
        click.echo(json.dumps(asdict(status), indent=1))
        return
    click.echo(f"{folder}: {status.identities_done} of {status.identities} people, {status.bytes / 1e9:.2f} GB")
    for table, asked in status.asked.items():
        each = " frames, 16 a sequence, which one bad frame rejects" if table == "sequences" else ""
        click.echo(f"  {table}: {status.accepted[table]} accepted of {asked}{each}")
    for message in status.damaged:
        click.echo(f"DAMAGED {message}")
    # Numbers differ from frame to frame; the reason is the same.
    reasons = Counter(f"{rejection.table}: {shorten_reason(rejection.reason)}" for rejection in status.rejected)
    for reason, count in reasons.most_common(FEW):
        click.echo(f"  rejected {count} of {reason}")
    if len(reasons) > FEW:
        click.echo(f"  and for {len(reasons) - FEW} other reasons; --json lists all")
