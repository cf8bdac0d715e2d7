"""The command and how it ends: errors are one line on stderr; exit status 0 means that everything was done."""

import os
import signal
import sys
import threading

import click

from ..lhm.base.errors import InputError, SoftdecaError, is_interrupt
from . import (  # noqa: F401  # they give `head` more commands
    animate,
    bench,
    corpus,
    head_export,
    head_files,
    study,
    take,
    train,
    train_regressor,
    view,
)
from .head import head


@click.group(context_settings={"show_default": True})
@click.version_option(package_name="softdeca", prog_name="softdeca", message="%(prog)s %(version)s")
def app() -> None:
    """A finite-element reference on FEniCSx, and a learned surrogate, for physics-based faces."""
    if any(int(os.environ.get(name, "1")) > 1 for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")):
        raise InputError("mpirun shares the solves of a script, not of a command; run softdeca without it")


app.add_command(study.study)
app.add_command(train.train)
app.add_command(train.evaluate)
app.add_command(head)
app.add_command(animate.animate)
app.add_command(take.take)
app.add_command(view.view)
app.add_command(corpus.corpus)
app.add_command(bench.bench)


def main() -> None:
    """Run the command; an error that a user can act on is one line, not a traceback."""
    sys.unraisablehook = _interrupt_again
    sys.exit(_run())


def _interrupt_again(lost: "sys.UnraisableHookArgs") -> None:
    """Interrupt the main thread once more where Ctrl-C met a `__del__` or a callback, which Python would ignore."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    # Another thread's signal, a moment later: one of this thread would be raised within this function.
    threading.Timer(0.01, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT)).start()


def _run() -> int:
    try:
        status = app.main(sys.argv[1:] or ["--help"], prog_name="softdeca", standalone_mode=False) or 0
        sys.stdout.flush()
        return status
    except SoftdecaError as error:
        return _fail(str(error))
    except BrokenPipeError:  # as of `| head`, which has read enough
        _silence_stdout()
        return 1
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        status = _fail(f"{where}{error.strerror or error}")
        try:
            sys.stdout.flush()
        except OSError:
            _silence_stdout()
        return status
    except (RecursionError, MemoryError) as error:
        return _fail(f"{type(error).__name__}: input nested too deeply, or too large for this machine's memory")
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "softdeca"
        return _fail(f"{error.format_message()} (`{command} --help` says more)", status=error.exit_code)
    except BaseException as error:
        if not (isinstance(error, click.Abort) or is_interrupt(error)):
            raise
        said = "softdeca: interrupted; what a study, corpus or training has finished is kept for the next run"
        print(said, file=sys.stderr)
        return 130  # 128 and the number of SIGINT, as shells have it


def _fail(message: str, *, status: int = 1) -> int:
    print(f"softdeca: error: {' '.join(message.split())}", file=sys.stderr)
    return status


def _silence_stdout() -> None:
    """Send what is still to be written nowhere: Python's last flush would fail, and tell it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
