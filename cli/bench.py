"""softdeca bench: one study by name."""

import json

import click

from ..reference import SOLVERS
from .progress import shown


@click.group(no_args_is_help=False)
def bench() -> None:
    """Single studies by name."""


@bench.command()
@click.option("--solver", "solvers", multiple=True, help=f"one of {', '.join(SOLVERS)}; repeat for several  [all]")
@click.option("--json", "as_json", is_flag=True, help="print the outcomes as JSON")
def verification(solvers: tuple[str, ...], as_json: bool) -> int:
    """Closed forms and published values through every solver, with error and bound; exit status 1 outside one."""
    from ..benchmarks.verification import verify

    asked = solvers or SOLVERS
    with shown() as progress:
        rows = verify(progress, solvers=asked)
    for solver in set(asked) - {row["solver"] for row in rows}:
        click.echo(f"softdeca: {solver} is not installed: left out", err=True)
    if as_json:
        click.echo(json.dumps(rows, indent=1))
    else:
        for row in rows:
            mark = "ok " if row["passed"] else "OUT"
            click.echo(
                f"{mark} {row['problem']:<60} {row['solver']:<11} {row['value']:<14.9g} error {row['error']:.1e}"
            )
    return 0 if all(row["passed"] for row in rows) else 1
