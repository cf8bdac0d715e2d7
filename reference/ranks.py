"""Processes that `mpirun` starts together: the first runs the command, the others do their part of its work.

The first process makes objects on the others and calls their methods, so every decision is its own and no two processes
can disagree. What it does alone (files, output, other solvers) the others wait for, asleep.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import pickle
import signal
import sys
import time
import traceback
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NoReturn

from ..lhm.errors import MissingDependencyError, SoftdecaError

SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
PLACES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK")
# What makes a process that this one starts believe that mpirun started it.
INHERITED = ("OMPI_", "PMIX_", "PMI_", "ORTE_", "PRTE_", "HYDRA_", "HYDI_")
KEPT = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")
AWAKE = 2e-3  # seconds of waiting for work, after which a process sleeps between its looks
NAP, LONGEST_NAP = 5e-5, 2e-3

_team: Team | None = None


@dataclass(frozen=True)
class Task:
    """A call of the object `key`: of its method, or of what makes it; `dropped` are objects that may go."""

    key: int
    method: str
    make: Callable[..., Any] | None
    arguments: tuple
    together: bool
    dropped: tuple[int, ...]


class Remote:
    """One object on each of the other processes, made by `Team.make`."""

    def __init__(self, team: Team, key: int):
        self._team, self._key = team, key
        weakref.finalize(self, team._dropped.append, key)

    def begin(self, method: str, arguments: Sequence[tuple]):
        """Call a method on each process, with its arguments; they answer to `end`."""
        self._team._send(self._key, method, arguments)

    def end(self) -> list:
        """What the processes answer to the last call; raises what one of them raised."""
        return self._team._receive()

    def call(self, method: str, arguments: Sequence[tuple]) -> list:
        """Begin and end."""
        self.begin(method, arguments)
        return self.end()

    @contextmanager
    def together(self, method: str, arguments: Sequence[tuple]) -> Iterator[list]:
        """Call a method that this process takes part in, within the block; its list is filled afterwards.

        An error in one process alone would leave the others waiting for it: it ends all of them.
        """
        with self._team._as_one():
            self._team._send(self._key, method, arguments, together=True)
            answers: list = []
            yield answers
        answers += self._team._receive()


class Team:
    """The other processes, as the first one sees them; `comm` is all of them, `size` their number."""

    def __init__(self, comm):
        self.comm, self.size = comm, comm.size
        self._pid = os.getpid()
        self._keys = 0
        self._dropped: list[int] = []
        self._unanswered = False
        self._stuck = False

    def begin_making(self, kind: Callable[..., Any], arguments: Sequence[tuple]) -> Remote:
        """An object of a kind on each of the others, with its arguments; there after its `end`."""
        remote = self._new()
        self._send(remote._key, "", arguments, make=kind)
        return remote

    def make(self, kind: Callable[..., Any], arguments: Sequence[tuple]) -> Remote:
        """The same, there at once."""
        remote = self.begin_making(kind, arguments)
        remote.end()
        return remote

    @contextmanager
    def making(self, kind: Callable[..., Any], arguments: Sequence[tuple]) -> Iterator[Remote]:
        """Like `make`, while this process makes its own within the block: see `Remote.together`."""
        remote = self._new()
        with self._as_one():
            self._send(remote._key, "", arguments, make=kind, together=True)
            yield remote
        self._receive()

    def _new(self) -> Remote:
        self._keys += 1
        return Remote(self, self._keys)

    @contextmanager
    def _as_one(self) -> Iterator[None]:
        self._stuck = True  # unless the block ends well
        yield
        self._stuck = False

    def _send(self, key: int, method: str, arguments: Sequence[tuple], *, make=None, together: bool = False):
        if self._stuck and not together:
            raise SoftdecaError("the processes of mpirun fell out of step when the last solve was cut off; start anew")
        if self._unanswered:  # an interruption kept a call from its end
            self._collect()
        dropped = tuple(self._dropped)
        del self._dropped[: len(dropped)]
        for rank, own in enumerate(arguments, start=1):
            self.comm.send(Task(key, method, make, own, together, dropped), dest=rank)
        self._unanswered = True

    def _collect(self) -> list[tuple[bool, Any]]:
        answers = [self.comm.recv(source=rank) for rank in range(1, self.size)]
        self._unanswered = False
        return answers

    def _receive(self) -> list:
        answers = self._collect()
        for fine, answer in answers:
            if not fine:
                raise answer
        return [answer for _, answer in answers]

    def dismiss(self, status: int):
        """Let the others end; where they wait for a call that this process has left, end all with the status."""
        if self._stuck:
            sys.stdout.flush()
            sys.stderr.flush()
            self.comm.Abort(status or 1)
        if self._unanswered:
            self._collect()
        for rank in range(1, self.size):
            self.comm.send(None, dest=rank)


def join() -> Team | None:
    """Become one of the processes that mpirun has started; None where it has started no other.

    Only the first process returns; the others work for it, and end when it ends or calls `leave`. Raises
    MissingDependencyError, in the first process, where mpi4py is missing or belongs to another MPI than mpirun.
    """
    global _team
    started = int(next((os.environ[name] for name in SIZES if name in os.environ), "1"))
    if started < 2:
        return None
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
    comm = pkl5.Intracomm(world)
    if comm.rank > 0:
        _serve(comm)
        sys.exit(0)
    for name in [n for n in os.environ if n.startswith(INHERITED) and n not in KEPT]:
        del os.environ[name]
    signal.signal(signal.SIGTERM, _interrupted)  # what mpirun sends when it is interrupted
    _team = Team(comm)
    atexit.register(leave)
    return _team


def team() -> Team | None:
    """The processes that have joined this one; None in a process of its own, as a child of the first is."""
    return _team if _team is not None and _team._pid == os.getpid() else None


def leave(status: int = 0):
    """Let the others end, as this process is about to; does nothing where none have joined."""
    global _team
    if team() is not None:
        _team.dismiss(status)  # type: ignore[union-attr]
    _team = None


def _interrupted(*_) -> NoReturn:
    raise KeyboardInterrupt


def _refuse(place: int, why: str) -> NoReturn:
    if place == 0:
        raise MissingDependencyError(why) from None
    sys.exit(1)


def _serve(comm):
    """Do what the first process asks for until it asks for the end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process decides what an interruption means
    warnings.simplefilter("ignore")
    held: dict[int, Any] = {}
    while True:
        _wait_for_work(comm)
        task = comm.recv(source=0)
        if task is None:
            return
        for key in task.dropped:
            held.pop(key, None)
        if task.dropped:
            gc.collect()  # problems and their states refer to one another
        try:
            if task.make is not None:
                held[task.key], answer = task.make(*task.arguments), None
            else:
                answer = getattr(held[task.key], task.method)(*task.arguments)
        except Exception as error:
            failure = _portable(error, comm.rank)
            if task.together:
                print(f"softdeca: error: {' '.join(str(failure).split())}", file=sys.stderr, flush=True)
                comm.Abort(1)
            comm.send((False, failure), dest=0)
        else:
            comm.send((True, answer), dest=0)


def _wait_for_work(comm):
    begin, nap = time.perf_counter(), NAP
    while not comm.Iprobe(source=0):
        if time.perf_counter() - begin > AWAKE:
            time.sleep(nap)
            nap = min(1.2 * nap, LONGEST_NAP)


def _portable(error: Exception, rank: int) -> Exception:
    """The error, or one that says the same and can be sent."""
    if isinstance(error, SoftdecaError):
        return error
    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:
        return RuntimeError(f"process {rank}: {traceback.format_exc()}")
