"""The `softdeca` command."""

import os

# One thread is the fastest for the solvers' small blocks; it must be set before a BLAS is loaded.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from .app import main  # noqa: E402

__all__ = ["main"]
