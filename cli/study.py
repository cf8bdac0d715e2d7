"""softdeca study: the main report."""

from pathlib import Path
from typing import Any

import click

from .study_command import ONLY, gate_line
from .terminal import show_progress
from .written_file import FOLDER


@click.command()
@click.option(
    "--identities", default="anny", help="identity space of the head: anny, ict:FILE, flame:FILE or folder:DIR"
)
@click.option("--out", default="out/study", type=FOLDER, help="folder of the report; rows in it are used again")
@click.option(
    "--expressions",
    default="jawOpen,mouthSmileLeft+mouthSmileRight,mouthPucker,cheekPuff,browInnerUp",
    help="ARKit expressions, separated by commas; join shapes with +, scale with *, as jawOpen*0.5",
)
@click.option(
    "--surrogate",
    type=click.Path(path_type=Path),
    help="weights to test, from `softdeca train`; default: the shipped network",
)
@click.option(
    "--only", type=click.Choice(ONLY), default="missing", help="rows to make: missing ones, failed ones again, or all"
)
@click.option("--json", "as_json", is_flag=True, help="print the results of all studies to stdout")
def study(identities: str, out: Path, expressions: str, surrogate: Path | None, only: Any, as_json: bool) -> int:
    """Compare every solver and the surrogate on one head: OUT/index.html and OUT/report.json.

    It runs quick versions of the studies of `softdeca bench`, each in a folder of OUT. An interrupted run resumes. Exit
    status 1 if an answer misses its bound or a study could not run. Missed aims of speed are printed only.
    """
    from ..benchmarks.main_study import run_study
    from ..benchmarks.studies.agreement.study import Agreement

    weights = "" if surrogate is None else str(surrogate)
    asked = Agreement(identities=identities, expressions=tuple(expressions.split(",")), weights=weights)
    with show_progress() as progress:
        done = run_study(asked, out, only=only, progress=progress)
    if as_json:
        click.echo((out / "report.json").read_text())
    else:
        for results in done.results:
            for row in results.rows:
                if row.status == "failed":
                    click.echo(f"FAILED {results.study}: {row.case}, {row.method}: {row.reason}")
            for gate in results.gates:
                click.echo(f"{gate_line(gate)}  [{results.study}]")
        for name, why in done.failed:
            click.echo(f"FAILED {name}: {why}")
        for path in done.written:
            click.echo(f"wrote {path}")
        click.echo(done.spent)
    return 0 if done.passed else 1
