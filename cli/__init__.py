"""The `softdeca` command."""

import os
import re
import sys
import warnings

# One thread is the fastest for the solvers' small blocks; it must be set before a BLAS is loaded.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")

# Pictures go to files. A backend that is asked for and not installed would end Matplotlib's import.
os.environ["MPLBACKEND"] = "agg"

__all__ = ["main"]


def main() -> None:
    """Run the command: see `app.main`."""
    warnings.showwarning = _in_one_line
    for name in COUNTS:
        value = os.environ.get(name, "1")
        if not re.fullmatch(r"[1-9]\d{0,5}(,[1-9]\d{0,5})*", value):
            os.environ[name] = "1"
            _in_one_line(f"{name}={value!r}: expected a count of threads; 1 is taken", UserWarning, __file__, 0)
    from .app import main as run

    run()


def _in_one_line(message, category, filename, lineno, file=None, line=None) -> None:
    text = str(message).partition("Traceback (most recent call last)")[0]
    print(f"softdeca: {' '.join(text.split())}", file=file or sys.stderr)
