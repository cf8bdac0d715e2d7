"""The command and how it ends: errors as one line on stderr, exit status 0 only when all asked for was done."""

import sys

import click

from ..lhm.errors import SoftdecaError
from ..reference import ranks
from . import animate, bench, corpus, head, simulate, study, train, view


@click.group(context_settings={"show_default": True})
def app() -> None:
    """A finite-element reference on FEniCSx, and a learned surrogate, for physics-based faces."""


app.add_command(study.study)
app.add_command(train.train)
app.add_command(train.evaluate)
app.add_command(head.head)
app.add_command(simulate.simulate)
app.add_command(animate.animate)
app.add_command(view.view)
app.add_command(corpus.corpus)
app.add_command(bench.bench)


def main() -> None:
    """Run the command; an error that a user can act on is one line, not a traceback.

    Of processes that mpirun starts together the first one runs it, and the others help FEniCSx.
    """
    try:
        ranks.lead()
        status = app.main(sys.argv[1:] or ["--help"], prog_name="softdeca", standalone_mode=False)
    except SoftdecaError as error:
        status = _fail(str(error))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        status = _fail(f"{where}{error.strerror or error}")
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "softdeca"
        status = _fail(f"{error.format_message()} (`{command} --help` says more)", status=error.exit_code)
    except (KeyboardInterrupt, click.Abort):
        print("softdeca: interrupted; what was finished is kept and used by the next run", file=sys.stderr)
        status = 130
    ranks.leave(status)
    sys.exit(status)


def _fail(message: str, *, status: int = 1) -> int:
    print(f"softdeca: error: {' '.join(message.split())}", file=sys.stderr)
    return status
