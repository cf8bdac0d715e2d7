"""Ranks: the processes that `mpirun` starts together. Every rank makes the same calls (SPMD).

FEniCSx divides each mesh among the ranks of a script or a command, and all of them have the answer. Under a command
rank 0 alone prints and writes: the others print nowhere and write into scratch folders.

A SoftdecaError is about what all ranks were given, so all raise it, and rank 0 tells it. Any other error in one rank
ends all of them, since the others may wait for it.
"""

from __future__ import annotations

import atexit
import importlib
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from ..lhm.base.errors import MissingDependencyError, SoftdecaError

Value = TypeVar("Value")

SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
PLACES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK")
# What makes a process that this one starts believe that mpirun started it.
INHERITED = ("OMPI_", "PMIX_", "PMI_", "ORTE_", "PRTE_", "HYDRA_", "HYDI_")
KEPT = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")
AGREED = 2.0  # seconds within which all ranks of a script, or those above 0 of a command, meet the same error
DRIFT = 60.0  # seconds that rank 0 of a command, which writes, may come later than the others
NAP = 2e-3  # seconds between two looks at who has come

_command: Any = None
"""The communicator of a command's ranks; None in a script, in a process alone and in a child of either."""
_stderr: int | None = None
"""The terminal's, in a rank of a command that prints nowhere."""


def begin() -> None:
    """Join the other ranks of this command, if mpirun has started some.

    Raises MissingDependencyError where mpi4py is missing or belongs to another MPI than mpirun.
    """
    global _command, _stderr
    started = _started()
    if started < 2:
        return
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")  # while waiting, leave the processor to who has work
    if int(next((os.environ[name] for name in PLACES if name in os.environ), "0")) > 0:
        _stderr = os.dup(2)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
    try:
        mpi = importlib.import_module("mpi4py.MPI")
    except ImportError as error:
        raise MissingDependencyError(
            f"mpirun has started {started} processes, but mpi4py cannot be imported ({error})"
        ) from None
    world = mpi.COMM_WORLD
    if world.size != started:
        library = mpi.Get_library_version().split(",")[0].strip()
        raise MissingDependencyError(
            f"mpirun has started {started} processes, but mpi4py knows {world.size}: use mpirun of {library}"
        )
    for name in [n for n in os.environ if n.startswith(INHERITED) and n not in KEPT]:
        del os.environ[name]
    signal.signal(signal.SIGTERM, _interrupt)  # what mpirun sends when it is interrupted
    _command = world.Dup()


def size() -> int:
    """How many ranks run this command; 1 in a script, whose ranks know their communicator."""
    return 1 if _command is None else _command.size


def first(value: Value) -> Value:
    """Return rank 0's value to all ranks of a command: for decisions by time, and numbers that threads round.

    Elsewhere the value itself. Every rank calls this; values travel by pickle.
    """
    if _command is None:
        return value
    given = _command.bcast(value)
    return value if _command.rank == 0 else given


def writable(folder: Path) -> Path:
    """Return the folder that this rank writes into in place of one: rank 0 itself, others a scratch copy of it.

    So that all take the same decisions about what is there. Every rank calls this; the copies go with their ranks.
    """
    if _command is None:
        return folder
    own = folder
    if _command.rank > 0:
        scratch = Path(tempfile.mkdtemp(prefix="softdeca-rank-"))
        atexit.register(shutil.rmtree, scratch, ignore_errors=True)
        own = scratch / folder.name
        if folder.is_dir():
            shutil.copytree(folder, own)
    _command.Barrier()  # rank 0 begins to write when it is copied
    return own


def check_in_step(words: str, *, failed: bool) -> None:
    """End all ranks of a command unless each comes here with the same words.

    A rank that has `failed` waits DRIFT seconds at most: the others may wait for it within a solve.
    """
    if _command is None:
        return
    if not _meet(_command, DRIFT if failed else None):
        _abort(1, f"rank {_command.rank} alone came to: {words}")
    others = _command.allgather(words)
    if others != [words] * len(others):
        _abort(1, f"the ranks of mpirun fell out of step: {', '.join(sorted(set(others)))}")


def leave(status: int, line: str) -> None:
    """Leave a command by an error or interruption that `line` tells; end the other ranks where they do not."""
    if _command is not None and not _meet(_command, AGREED if _command.rank == 0 else DRIFT):
        _abort(status, line if _command.rank > 0 else "")


def _started() -> int:
    """How many processes mpirun has started."""
    return int(next((os.environ[name] for name in SIZES if name in os.environ), "1"))


def _meet(comm, seconds: float | None) -> bool:
    """Whether all ranks come here, within so many seconds if given."""
    met, begin = comm.Ibarrier(), time.perf_counter()
    while not (together := met.Test()) and (seconds is None or time.perf_counter() - begin < seconds):
        time.sleep(NAP)
    return together


def _abort(status: int, line: str) -> NoReturn:
    """End all ranks, with a line on the terminal's stderr if given."""
    _speak()
    if line:
        print(line if line.startswith("softdeca:") else f"softdeca: error: {line}", file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    _command.Abort(status or 1)
    raise SystemExit(status)


def _speak() -> None:
    """Let a silent rank print on the terminal's stderr again."""
    if _stderr is not None:
        os.dup2(_stderr, 2)


def _interrupt(*_) -> NoReturn:
    raise KeyboardInterrupt


def _end_all(kind: type[BaseException], error: BaseException, where) -> None:
    """Tell an error that nothing has caught, and end all ranks that may wait for this one.

    Where all of them meet one, rank 0 tells it and each ends by itself.
    """
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    together = _meet(comm, AGREED)
    if not together:
        _speak()
    if comm.rank == 0 or not together:
        if isinstance(error, SoftdecaError):
            print(f"softdeca: error: {' '.join(str(error).split())}", file=sys.stderr)
        else:
            traceback.print_exception(kind, error, where)
    sys.stderr.flush()
    if not together:
        comm.Abort(1)


if _started() > 1:
    sys.excepthook = _end_all
