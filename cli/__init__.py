"""The `softdeca` command."""

import os
import signal
import sys
import warnings

from .streams import open_closed_streams

# One thread is the fastest for the solvers' small blocks; it must be set before a BLAS is loaded.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# Pictures go to files. A backend that is asked for and not installed would end Matplotlib's import.
os.environ["MPLBACKEND"] = "agg"

__all__ = ["main"]


def main() -> None:
    """Run the command: see `app.main`. Interrupted while its modules are being loaded it ends in one line too."""
    open_closed_streams()
    warnings.showwarning = _in_one_line
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # elsewhere somebody has decided otherwise, as nohup has
        # Not by KeyboardInterrupt: inside an import it becomes whatever the module makes of it.
        signal.signal(signal.SIGINT, _end)
    from .app import main as run

    signal.signal(signal.SIGINT, before)
    run()


def _end(*_) -> None:
    os.write(2, b"softdeca: interrupted\n")
    os._exit(130)


def _in_one_line(message, category, filename, lineno, file=None, line=None) -> None:
    print(f"softdeca: {' '.join(str(message).split())}", file=file or sys.stderr)
