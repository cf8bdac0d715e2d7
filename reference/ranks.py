"""Processes that `mpirun` starts together.

A script is ordinary SPMD: every process makes the same calls, FEniCSx divides each mesh among them, and all have the
answer. A command has files and a terminal, so its first process runs it, and the others make the calls of FEniCSx
that the first one makes: `lead` and `mirrored`. They wait for the next one asleep.

A SoftdecaError is about what all processes were given, so all raise it and it is told once. Any other error in one
process ends all of them: the others may wait for it (`end_all`).
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import signal
import sys
import time
import traceback
import warnings
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

from ..lhm.base.errors import MissingDependencyError, SoftdecaError

SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
PLACES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK")
# What makes a process that this one starts believe that mpirun started it.
INHERITED = ("OMPI_", "PMIX_", "PMI_", "ORTE_", "PRTE_", "HYDRA_", "HYDI_")
KEPT = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")
AWAKE = 2e-3  # seconds of waiting for work, after which a process sleeps between its looks
NAP, LONGEST_NAP = 5e-5, 2e-3
AGREED = 2.0  # seconds within which all processes meet the same error

_followers: Followers | None = None


@dataclass(frozen=True)
class Call:
    """A call of the object `key`: of its method, or of what makes it; `dropped` are objects that may go."""

    key: int
    method: str
    make: Callable[..., Any] | None
    arguments: tuple
    named: dict[str, Any]
    dropped: tuple[int, ...]


class Mirrored:
    """An object that this process and all its followers have made, and whose methods all of them call together."""

    def __init__(self, followers: Followers, make: Callable[..., Any], *arguments, **named):
        self._followers, self._key = followers, followers.new_key()
        weakref.finalize(self, followers.dropped.append, self._key)
        with followers.make_too(Call(self._key, "", make, arguments, named, followers.take_dropped())):
            self.own = make(*arguments, **named)

    def call(self, method: str, *arguments, here: dict[str, Any] | None = None, **named) -> Any:
        """What the method gives in this process; `here` are arguments that it alone has."""
        followers = self._followers
        with followers.make_too(Call(self._key, method, None, arguments, named, followers.take_dropped())):
            return getattr(self.own, method)(*arguments, **named, **(here or {}))


class Followers:
    """The other processes, as the first one sees them."""

    def __init__(self, comm):
        self.comm, self.size = comm, comm.size
        self.pid = os.getpid()
        self.dropped: list[int] = []
        self._keys = 0
        self._within = False

    def new_key(self) -> int:
        """A name for another object."""
        self._keys += 1
        return self._keys

    def take_dropped(self) -> tuple[int, ...]:
        """The objects that have gone here since the last call."""
        dropped = tuple(self.dropped)
        del self.dropped[: len(dropped)]
        return dropped

    def import_too(self, name: str) -> Followers:
        """Let the others import a module that this process imports within a `with` of what is returned."""
        return self.make_too(Call(self.new_key(), "", importlib.import_module, (name,), {}, self.take_dropped()))

    def make_too(self, call: Call) -> Followers:
        """Let the others make a call that this process makes within a `with` of what is returned."""
        if self._within:
            raise SoftdecaError("the processes of mpirun fell out of step when the last solve was cut off; start anew")
        for rank in range(1, self.size):
            self.comm.send(call, dest=rank)
        return self

    def __enter__(self):
        self._within = True

    def __exit__(self, kind, error, where):
        self._within = error is not None and not isinstance(error, SoftdecaError)

    def dismiss(self, status: int):
        """Let the others end; where they are in a call that this process has left, end all with the status."""
        if self._within:
            sys.stdout.flush()
            sys.stderr.flush()
            self.comm.Abort(status or 1)
        for rank in range(1, self.size):
            self.comm.send(None, dest=rank)


def lead() -> None:
    """Become the first of the processes that mpirun has started, if it has, to run a command for all of them.

    Only the first process returns; the others follow it, and end when it ends or calls `leave`. Raises
    MissingDependencyError, in the first process, where mpi4py is missing or belongs to another MPI than mpirun.
    """
    global _followers
    started = _started()
    if started < 2:
        return
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")  # while waiting, leave the processor to who has work
    place = int(next((os.environ[name] for name in PLACES if name in os.environ), "0"))
    try:
        from mpi4py.util import pkl5

        mpi = importlib.import_module("mpi4py.MPI")
    except ImportError as error:
        _refuse(place, f"mpirun has started {started} processes, but mpi4py cannot be imported ({error})")
    world = mpi.COMM_WORLD
    if world.size != started:
        of = mpi.Get_library_version().split(",")[0].strip()
        _refuse(place, f"mpirun has started {started} processes, but mpi4py knows {world.size}: use mpirun of {of}")
    comm = pkl5.Intracomm(world.Dup())
    if comm.rank > 0:
        _follow(comm)
        sys.exit(0)
    for name in [n for n in os.environ if n.startswith(INHERITED) and n not in KEPT]:
        del os.environ[name]
    signal.signal(signal.SIGTERM, _interrupted)  # what mpirun sends when it is interrupted
    _followers = Followers(comm)
    atexit.register(leave)


def followers() -> Followers | None:
    """The processes that follow this one; None in a script, and in a process of its own, as a child of the first is."""
    return _followers if _followers is not None and _followers.pid == os.getpid() else None


def leave(status: int = 0):
    """Let the others end, as this process is about to; does nothing where none follow."""
    global _followers
    if (others := followers()) is not None:
        others.dismiss(status)
    _followers = None


def _started() -> int:
    """How many processes mpirun has started."""
    return int(next((os.environ[name] for name in SIZES if name in os.environ), "1"))


def end_all(kind: type[BaseException], error: BaseException, where):
    """What a process does with an error that nothing has caught: tell it, and end all processes that may wait for it.

    Where all of them meet one the first tells it, and each ends by itself.
    """
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    met, begin = comm.Ibarrier(), time.perf_counter()
    while not (together := met.Test()) and time.perf_counter() - begin < AGREED:
        time.sleep(LONGEST_NAP)
    if comm.rank == 0 or not together:
        if isinstance(error, SoftdecaError):
            print(f"softdeca: error: {' '.join(str(error).split())}", file=sys.stderr)
        else:
            traceback.print_exception(kind, error, where)
    sys.stderr.flush()
    if not together:
        comm.Abort(1)


def _interrupted(*_) -> NoReturn:
    raise KeyboardInterrupt


def _refuse(place: int, why: str) -> NoReturn:
    if place == 0:
        raise MissingDependencyError(why) from None
    sys.exit(1)


def _follow(comm):
    """Make the calls that the first process makes until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process decides what an interruption means
    warnings.simplefilter("ignore")
    held: dict[int, Any] = {}
    while True:
        _wait_for_work(comm)
        call = comm.recv(source=0)
        if call is None:
            return
        for key in call.dropped:
            held.pop(key, None)
        if call.dropped:
            gc.collect()  # problems and their states refer to one another
        try:
            if call.make is not None:
                held[call.key] = call.make(*call.arguments, **call.named)
            else:
                getattr(held[call.key], call.method)(*call.arguments, **call.named)
        except SoftdecaError:
            pass  # the first process has it too
        except Exception:
            traceback.print_exc()
            comm.Abort(1)


def _wait_for_work(comm):
    begin, nap = time.perf_counter(), NAP
    while not comm.Iprobe(source=0):
        if time.perf_counter() - begin > AWAKE:
            time.sleep(nap)
            nap = min(1.2 * nap, LONGEST_NAP)


if _started() > 1:
    sys.excepthook = end_all
