"""Ranks: the processes of a script that `mpirun` starts together. Every rank makes the same calls (SPMD).

FEniCSx divides each mesh among the ranks, and all of them have the answer. A SoftdecaError is about what all ranks were
given, so all raise it, and rank 0 tells it. Any other error in one rank ends all of them, since the others may wait
for it.
"""

from __future__ import annotations

import os
import sys
import time
import traceback

from ..lhm.base.errors import SoftdecaError

SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
AGREED = 2.0  # seconds within which all ranks meet the same error
NAP = 2e-3  # seconds between two looks at who has come


def count_started() -> int:
    """Count the processes that mpirun has started; 1 without it."""
    return int(next((os.environ[name] for name in SIZES if name in os.environ), "1"))


def _end_all(kind: type[BaseException], error: BaseException, where) -> None:
    """Tell an error that nothing has caught, and end all ranks that may wait for this one.

    Where all of them meet one, rank 0 tells it and each ends by itself.
    """
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    met, begin = comm.Ibarrier(), time.perf_counter()
    while not (together := met.Test()) and time.perf_counter() - begin < AGREED:
        time.sleep(NAP)
    if comm.rank == 0 or not together:
        if isinstance(error, SoftdecaError):
            print(f"softdeca: error: {' '.join(str(error).split())}", file=sys.stderr)
        else:
            traceback.print_exception(kind, error, where)
    sys.stderr.flush()
    if not together:
        comm.Abort(1)


if count_started() > 1:
    sys.excepthook = _end_all
