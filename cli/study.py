"""softdeca study: the main report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import click

from .options import FILE, make_command, option
from .study_command import describe_gate
from .terminal import show_progress
from .written_file import FOLDER


@dataclass(frozen=True)
class MainStudy:
    """Compare every solver and the network on unseen faces: OUT/index.html and OUT/report.json.

    It runs studies of `softdeca bench`, each in a folder of OUT, and writes the page as results come. An interrupted
    run resumes; what failed is tried again. Exit status 1 if an answer misses its bound or a study could not run.
    """

    identities: str = option("anny", "identity space of the people: anny, ict:FILE, flame:FILE or folder:DIR")
    out: Path = option("out/study", "folder of the report; rows in it are used again", type=FOLDER)
    expressions: str = option(
        "jawOpen*0.6,mouthSmileLeft*0.7+mouthSmileRight*0.7,mouthPucker*0.7",
        "ARKit expressions of the mean face, separated by commas; join shapes with +, scale with *, as jawOpen*0.5",
        name="--expressions",
    )
    surrogate: Path | None = option(
        None, "weights to test, from `softdeca train`; default: the shipped network", type=FILE
    )
    small: bool = option(False, "a quick look: the coarsest heads, one person, no pass or fail")
    json: bool = option(False, "print the results of all studies to stdout")

    def run(self) -> int:
        """Run the studies, and print gates and files."""
        from ..benchmarks.main_study import run_study
        from ..benchmarks.studies.faces import Faces
        from ..lhm.template.template import LEVELS

        weights = "" if self.surrogate is None else str(self.surrogate)
        asked = Faces(identities=self.identities, expressions=tuple(self.expressions.split(",")), weights=weights)
        if self.small:
            asked = replace(
                asked, level=min(LEVELS), people=1, converged=0, frames=1, expressions=asked.expressions[:1]
            )
        with show_progress() as progress:
            done = run_study(asked, self.out, small=self.small, progress=progress)
        status = 0 if (done.complete if self.small else done.passed) else 1
        if self.json:
            click.echo((self.out / "report.json").read_text())
            return status
        for results in done.results:
            for row in results.rows:
                if row.status == "failed":
                    click.echo(f"FAILED {results.study}: {row.case}, {row.method}: {row.reason}")
            for gate in results.gates:
                click.echo(f"{describe_gate(gate)}  [{results.study}]")
        for name, why in done.failed:
            click.echo(f"FAILED {name}: {why}")
        for path in done.written:
            click.echo(f"wrote {path}")
        click.echo(done.spent)
        return status


study = make_command("study", MainStudy)
