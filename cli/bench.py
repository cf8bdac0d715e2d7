"""softdeca bench: one study by name."""

import json
from typing import Annotated

import typer

from ..reference import SOLVERS
from .progress import shown

app = typer.Typer(help="Single studies by name.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Single studies by name."""


@app.command()
def verification(
    solver: Annotated[list[str] | None, typer.Option(help=f"one of {', '.join(SOLVERS)}; repeat for several")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the outcomes as JSON")] = False,
) -> int:
    """Closed forms and published values through every solver, with error and bound; exit status 1 outside one."""
    from ..benchmarks.verification import verify

    with shown() as progress:
        rows = verify(progress, solvers=tuple(solver or SOLVERS))
    if as_json:
        typer.echo(json.dumps(rows, indent=1))
    else:
        for row in rows:
            mark = "ok " if row["passed"] else "OUT"
            typer.echo(
                f"{mark} {row['problem']:<44} {row['solver']:<11} {row['value']:<14.9g} error {row['error']:.1e}"
            )
    return 0 if all(row["passed"] for row in rows) else 1
