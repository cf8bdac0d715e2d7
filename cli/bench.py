"""softdeca bench: studies by name, their list, two results side by side, and one report of many."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from ..benchmarks.studies import group_studies, list_studies, load_study
from ..lhm.base.errors import InputError, quote
from .options import FILE, argument, as_command, option
from .study_command import command_of_study, print_results
from .terminal import show_progress
from .written_file import FOLDER, ZIP

TITLE = "the fast simulator, finite elements and the network"
"""Title of a report."""


class Studies(click.Group):
    """A group with a command for each study, made when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Name studies and the other commands."""
        return sorted({*list_studies(), *super().list_commands(ctx)})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Give the command of a study, or another."""
        return command_of_study(load_study(name)) if name in list_studies() else super().get_command(ctx, name)


def add_files(context: click.Context, parameter: click.Parameter, files: tuple[Path, ...]) -> None:
    """Load files of laws, solvers, methods and studies."""
    from ..reference.added import add_file

    for path in files:
        add_file(path)


@click.group(cls=Studies, no_args_is_help=False)
@click.option(
    "--add",
    type=FILE,
    multiple=True,
    callback=add_files,
    is_eager=True,
    expose_value=False,
    help="a Python file of laws, solvers, methods or studies of your own; repeat for several",
)
def bench() -> None:
    """Single studies by name."""


@as_command(bench, "list")
@dataclass(frozen=True)
class ListStudies:
    """List the studies under the questions that they answer, as the report has them."""

    def run(self) -> int:
        """Print them."""
        for question, names in group_studies(list_studies()).items():
            click.echo(question)
            for name in names:
                kind = load_study(name)
                click.echo(f"  {name:<16} {kind.question}")
        return 0


@as_command(bench, "compare")
@dataclass(frozen=True)
class CompareResults:
    """Compare two results of one study: costs and answers that changed by more than noise, and what one has not done.

    BEFORE and AFTER are folders of a study, or their results.json. Exit status 1 if a cost rose, a task is not done any
    more, or a statement not reached.
    """

    before: Path = argument("BEFORE", type=FILE)
    after: Path = argument("AFTER", type=FILE)

    def run(self) -> int:
        """Read both and print what changed."""
        from ..benchmarks.harness.results import compare_results, read_results

        name = read_results(self.before)["study"]
        if name not in list_studies():
            raise InputError(f"{self.before}: of a study {quote(name)!r}, which there is not")
        comparison = compare_results(self.before, self.after, load_study(name))
        changes = [change for change in comparison.changes if change.is_beyond_noise]
        for change in changes:
            click.echo(f"{change.share:+8.1%}  {change.task}, {change.what}: {change.before:.4g} -> {change.after:.4g}")
        for line in [*comparison.broken, *comparison.other]:
            click.echo(line)
        for what, cost in (("answers", False), ("costs", True)):
            count = sum(change.cost is cost for change in comparison.changes)
            changed = sum(change.cost is cost for change in changes)
            click.echo(f"{count - changed} of {count} {what} are the same within noise")
        return 1 if comparison.broken or any(change.cost and change.share > 0 for change in changes) else 0


@as_command(bench, "report")
@dataclass(frozen=True)
class WriteReport:
    """Write one report of many studies: OUT/index.html, report.md, report.json and tables.tex (booktabs).

    RESULTS are folders of studies, or their results.json; by default all folders in `out` that hold one.
    """

    results: tuple[Path, ...] = argument("[RESULTS]...", (), type=FILE)
    out: Path = option("out/report", "folder of the report", type=FOLDER)

    def run(self) -> int:
        """Read the results and write the report."""
        from ..benchmarks.harness.report import read_part, write_report

        known = (Path("out") / name / "results.json" for name in list_studies())
        paths = self.results or tuple(path for path in known if path.is_file())
        if not paths:
            raise InputError("report: no results in out/; run a study first, as `softdeca bench verification`")
        for path in write_report([read_part(each, load_study) for each in paths], self.out, TITLE):
            click.echo(f"wrote {path}")
        return 0


@as_command(bench, "export")
@dataclass(frozen=True)
class ExportFaceBenchmark:
    """Write the archive of the open face benchmark: meshes, materials, loads and converged answers with their bands.

    Solves what RESULTS lacks of `softdeca bench face-benchmark`, and resumes. All takes half an hour of one core and
    12 GB. Exit status 1 if a gate is missed.
    """

    out: Path = argument("OUT", type=ZIP)
    results: Path = option(Path("out/face-benchmark"), "folder of the solved rows", type=FOLDER)
    small: bool = option(False, "leave out the fine mesh, as the archive in the repository does")

    def run(self) -> int:
        """Solve and write."""
        from ..benchmarks.face.export import export
        from ..benchmarks.studies.mesh.face import FaceBenchmark

        study = FaceBenchmark()
        with show_progress() as progress:
            results, size = export(self.out, study, self.results, small=self.small, progress=progress)
        print_results(study, results, self.results)
        click.echo(f"wrote {self.out} ({size / 1e6:.1f} MB)")
        return 0 if results.passed else 1


@as_command(bench, "score")
@dataclass(frozen=True)
class ScoreAnswer:
    """Score an answer to the open face benchmark, on any of its meshes, without any of our solvers.

    ANSWER is a .vtu file with `displacement` [mm] on its points. `reaction` [mN] on points and `cauchy` [kPa] on tets
    are scored too if there. The first line says whether it is right, wrong, shifted, truncated or not finite.
    Exit status 1 if it is faulty.
    """

    answer: Path = argument("ANSWER", type=FILE)
    archive: Path | None = option(
        None, "from `bench export`, or its folder  [the repository's, of the coarse and medium mesh]", type=FILE
    )
    problem: str = option("", "default: the one that the file's name has in it")
    json: bool = option(False, "print the score as JSON, as benchmarks/face/answers keeps it")

    def run(self) -> int:
        """Print the score."""
        from ..benchmarks.face.score import ARCHIVE, AnswerError, Archive, describe_score, score, write_score

        try:
            archive = Archive(self.archive or ARCHIVE)
            result = score(self.answer, archive, self.problem)
        except AnswerError as error:
            raise InputError(str(error)) from None
        click.echo(write_score(result, archive) if self.json else "\n".join(describe_score(result)))
        return 0 if result.verdict.startswith("right") else 1
