"""Where work over many items runs: in this process, in others of this machine, or on a cluster. Dask schedules it.

What is made lies in files, which are the truth: an item's result here is a few bytes that say that it is done. So a
process that dies loses only what it was at, a run that is stopped goes on later, and nothing depends on the order.
"""

from __future__ import annotations

import logging
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

from threadpoolctl import threadpool_limits

from ...lhm.base.errors import InputError, MissingDependencyError, SoftdecaError
from ...lhm.base.limits import WORKERS

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Result = TypeVar("Result")
Where = Literal["serial", "processes", "dask"]
AHEAD = 2
"""Items per worker that are handed out at a time: enough that none waits, few enough to stop soon."""
RETRIES = 2
"""How often an item whose worker died is tried again."""
ENVIRONMENT = {name: 1 for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MALLOC_ARENA_MAX")}
ENVIRONMENT |= {"MALLOC_MMAP_THRESHOLD_": 2**20}
"""Environment of workers: one thread, and memory that goes back with its array (a worker grew to two gigabytes)."""
PATIENCE = "30s"
"""With a scheduler that does not answer."""
_ADDRESS = re.compile(r"\w+://\S+|[^\s/:]\S*:\d{1,5}")


@dataclass(frozen=True)
class Schedule:
    """`where`: "serial"; "processes", `workers` of this machine; "dask", the cluster of a scheduler at `address`.

    Raises InputError for workers beyond `limits.WORKERS`, for what is no address, and for one without "dask" or the
    other way round.
    """

    where: Where = "serial"
    workers: int = 1
    address: str | None = None

    def __post_init__(self):
        if self.where not in get_args(Where):
            raise InputError(f"schedule {self.where!r}: there are {', '.join(get_args(Where))}")
        WORKERS.check("workers", self.workers)
        if (self.where == "dask") != (self.address is not None):
            raise InputError("schedule: a scheduler's address belongs to 'dask', and 'dask' needs one")
        if self.address is not None and not _ADDRESS.fullmatch(self.address):
            raise InputError(f"scheduler {self.address[:60]!r}: expected an address, as tcp://host:8786")


def make_schedule(workers: int = 1, address: str | None = None) -> Schedule:
    """Return the cluster of a scheduler's address where one is given; else processes, for one worker this one."""
    if address is not None:
        return Schedule("dask", workers, address)
    return Schedule("serial" if workers == 1 else "processes", workers)


def check_scheduler(on: Schedule) -> None:
    """Raise InputError now where the scheduler of a cluster does not answer, rather than after minutes of set-up."""
    if on.where == "dask":
        with _client(on, 1):
            pass


def run_items(
    work: Callable[[Item], Result], items: Sequence[Item], *, on: Schedule, name: str = "work"
) -> Iterator[Result]:
    """Run `work` on each item, on one thread each; results come as they are done.

    `work` travels to each process once, by pickle. Raises what `work` raises; SoftdecaError naming `name` where an
    item's worker died RETRIES + 1 times; InputError where no scheduler answers, and MissingDependencyError without
    Dask. The processes of "processes" end with the iterator, and with this process.
    """
    if not items:
        return
    if on.where == "serial" or (on.where == "processes" and len(items) == 1):
        with threadpool_limits(1):
            yield from map(work, items)
        return
    with _client(on, len(items)) as client:
        yield from _schedule(client, work, items, name)


def _schedule(client: Client, work: Callable[[Item], Result], items: Sequence[Item], name: str) -> Iterator[Result]:
    from distributed import KilledWorker, as_completed

    # A task's result, unlike scattered data, is made again where the workers that had it died.
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")  # once, and some megabytes
        shared = client.submit(_give, work, pure=False)
    waiting = iter(items)

    def submit(count: int) -> list[Any]:
        return [client.submit(_single, shared, item, pure=False) for item in islice(waiting, count)]

    workers = max(1, len(client.scheduler_info()["workers"]))
    done = as_completed(submit(AHEAD * workers))
    for future in done:
        try:
            result = future.result()
        except KilledWorker:
            raise SoftdecaError(f"{name}: a worker process died; run again to go on where it stopped") from None
        for more in submit(1):
            done.add(more)
        yield result


def _give(work: Callable[[Item], Result]) -> Callable[[Item], Result]:
    return work


def _single(work: Callable[[Item], Result], item: Item) -> Result:
    """One item, on one thread: sums over several are not the same to the last bit."""
    with threadpool_limits(1):
        return work(item)


@contextmanager
def _client(on: Schedule, items: int) -> Iterator[Client]:
    try:
        import dask
        from distributed import Client
        from distributed.utils import silence_logging_cmgr
    except ImportError:
        raise MissingDependencyError("several workers need Dask: pip install 'distributed>=2024.1'") from None
    settings = {
        "distributed.scheduler.allowed-failures": RETRIES,
        "distributed.worker.memory.target": False,
        "distributed.worker.memory.spill": False,
        "distributed.worker.daemon": True,
        "distributed.nanny.pre-spawn-environ": ENVIRONMENT,
        "distributed.comm.timeouts.connect": PATIENCE,
    }
    with dask.config.set(settings):
        if on.where == "dask":
            try:
                client = Client(on.address, timeout=PATIENCE)
            except (OSError, TimeoutError, ValueError) as error:
                raise InputError(f"scheduler {on.address}: no Dask scheduler answers ({_short(error)})") from None
            with client:
                yield client
            return
        # The cluster's own silence ends with its close; what its connections say after that helps nobody either.
        with silence_logging_cmgr(logging.CRITICAL), _processes(min(on.workers, items)) as client:
            yield client


@contextmanager
def _processes(workers: int) -> Iterator[Client]:
    """Start a cluster of this machine, which ends at once with the context, whatever runs on it."""
    from distributed import Client, LocalCluster

    with without_interrupts():
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=None,
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": ":0"},  # its own port, or a second cluster would warn of the first
            silence_logs=logging.CRITICAL,
        )
    with _ended_by_sigterm(), cluster, Client(cluster) as client:
        try:
            yield client
        finally:
            # Closing waits for what runs, and what is done lies in files.
            for nanny in cluster.workers.values():
                nanny.auto_restart = False
                if nanny.pid is not None:
                    with suppress(ProcessLookupError):  # it may have died meanwhile
                        os.kill(nanny.pid, signal.SIGKILL)


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end the process by SystemExit, so that processes and semaphores are given back first."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Processes that begin within are not reached by Ctrl-C, which goes to every process of a terminal.

    The one that starts them decides, and ends the others. They inherit that it is blocked; the tracker of resources
    would unblock it if it began later.
    """
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _short(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:80]


def count_processors() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
