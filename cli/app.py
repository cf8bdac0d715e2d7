"""The command and how it ends: errors as one line on stderr, exit status 0 only when all asked for was done."""

import sys

import click
import typer

from ..lhm.errors import SoftdecaError
from . import bench, head, study

app = typer.Typer(
    help="A finite-element reference on FEniCSx, and a learned surrogate, for physics-based faces.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("study")(study.study)
app.add_typer(head.app, name="head")
app.add_typer(bench.app, name="bench")


def main() -> None:
    """Run the command; an error that a user can act on is one line, not a traceback."""
    try:
        status = app(standalone_mode=False)
    except SoftdecaError as error:
        status = _fail(error)
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        status = _fail(f"{error.strerror or error}{where}")
    except click.ClickException as error:
        error.show()
        status = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        print("softdeca: interrupted; what was finished is kept and used by the next run", file=sys.stderr)
        status = 130
    sys.exit(status)


def _fail(message) -> int:
    print(f"softdeca: error: {' '.join(str(message).split())}", file=sys.stderr)
    return 1
