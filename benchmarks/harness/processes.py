"""Processes that measure one task after another: one that dies, or takes too long, costs its own task and no other."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import threading
import time
from collections.abc import Iterator, Sequence, Set
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from ...lhm.base.errors import is_interrupt
from ...reference.added import add_file, added_files
from ...surrogate.corpus.schedule import without_interrupts
from .study import Study, Task, Values, describe_failure

MEGABYTE = 1e6


def read_cpu_seconds() -> float:
    """Read processor time [s] of this process, and of those it has started that have ended."""
    own, ended = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + ended.ru_utime + ended.ru_stime


def peak_megabytes() -> float:
    """Give the most memory [MB] that this process has held since its start, or since `reset_peak`."""
    # Not ru_maxrss alone: through exec it keeps what the parent held.
    size = _status("VmHWM")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MEGABYTE if size is None else size


def held_megabytes() -> float:
    """Give the memory [MB] that this process holds now; where the system does not say, the most it has held."""
    size = _status("VmRSS")
    return peak_megabytes() if size is None else size


def reset_peak() -> None:
    """Let `peak_megabytes` start anew from what is held now, where the system can (Linux)."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass


def _status(key: str) -> float | None:
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return None
    return next((float(line.split()[1]) * 1024 / MEGABYTE for line in lines if line.startswith(key + ":")), None)


@dataclass(frozen=True, eq=False)
class Job:
    """A task of a study; another object is another job."""

    study: Study
    task: Task

    @property
    def case(self) -> tuple[str, str]:
        """Study and case; their tasks may share what a process has kept."""
        return self.study.name, self.task.case


@dataclass(frozen=True)
class Outcome:
    """End of a task: "done" with values, "skipped" or "failed" with a reason; its costs.

    `seconds` of wall time; `cpu` [s], of its process and of those that it started, None where it was killed; peak
    memory [MB].
    """

    job: Job
    status: str
    reason: str = ""
    values: Values = field(default_factory=dict)
    seconds: float = 0.0
    cpu: float | None = None
    memory_mb: float | None = None


def measure_jobs(jobs: Sequence[Job], lanes: int) -> Iterator[Outcome]:
    """Measure each job, by as many processes side by side; they end with the iterator.

    A process goes on with the case that it is at, of which it may have kept something.
    """
    waiting = list(jobs)
    running: dict[Future, _Lane] = {}
    idle = [_Lane() for _ in range(max(1, min(lanes, len(jobs))))]
    every = list(idle)
    try:
        while waiting or running:
            while waiting and idle:
                lane = idle.pop()
                job = lane.choose(waiting, {other.job.case for other in running.values() if other.job})
                waiting.remove(job)
                running[lane.submit(job)] = lane
            done, _ = wait(running, timeout=0.5, return_when=FIRST_COMPLETED)
            for future, lane in list(running.items()):
                if future in done or lane.overdue:
                    del running[future]
                    yield lane.result(future)
                    idle.append(lane)
    finally:
        for lane in every:
            lane.end()


class _Lane:
    """One process at a time; a new one where the last died, was ended, or a task has its own."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self.job: Job | None = None
        """The one that it is at, or was at last."""
        self._begin = 0.0

    def submit(self, job: Job) -> Future:
        """Start a job, in the process that runs or in a new one."""
        if job.study.alone:
            self.end()
        self.job, self._begin = job, time.monotonic()
        if self._pool is not None:
            return self._pool.submit(_measure, job)
        self._pool = ProcessPoolExecutor(
            1, multiprocessing.get_context("spawn"), initializer=_begin, initargs=(added_files(),)
        )
        with without_interrupts():  # the process begins with its first task
            return self._pool.submit(_measure, job)

    def choose(self, waiting: Sequence[Job], elsewhere: Set[tuple[str, str]]) -> Job:
        """Choose the first of its own case, else of one that is not done elsewhere, else of all."""
        own = (job for job in waiting if self.job and job.case == self.job.case)
        new = (job for job in waiting if job.case not in elsewhere)
        return next(own, None) or next(new, None) or waiting[0]

    @property
    def overdue(self) -> bool:
        return self.job is not None and time.monotonic() - self._begin > self.job.study.limit

    def result(self, future: Future) -> Outcome:
        """Give the outcome of the last job; a job past its limit is ended, and it failed."""
        assert self.job is not None
        seconds, limit = time.monotonic() - self._begin, self.job.study.limit
        if not future.done():
            self.end()
            return Outcome(self.job, "failed", f"ended after {limit:g} s", seconds=seconds)
        try:
            outcome: Outcome = replace(future.result(), job=self.job)
        except BrokenProcessPool:
            self.end()
            return Outcome(self.job, "failed", "its process died", seconds=seconds)
        if self.job.study.alone:
            self.end()
        return outcome

    def end(self) -> None:
        """Kill the process: what it has done is written already."""
        if self._pool is not None:
            for pid in list(self._pool._processes or ()):
                with suppress(ProcessLookupError):  # it has ended by itself
                    os.kill(pid, signal.SIGKILL)
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


def _begin(files: Sequence[Path]) -> None:
    # Ctrl-C reaches every process of a terminal; the first one decides, and takes the others with it however it ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    first = multiprocessing.parent_process()
    assert first is not None

    def end_with_the_first() -> None:
        first.join()
        os._exit(1)

    threading.Thread(target=end_with_the_first, daemon=True).start()
    for path in files:
        add_file(path)


def _measure(job: Job) -> Outcome:
    reset_peak()
    begin, spent = time.perf_counter(), read_cpu_seconds()
    status, reason = "done", ""
    values: Values = {}
    try:
        with threadpool_limits(1):
            values = job.study.measure(job.task)
    except (Exception, SystemExit) as error:  # a SystemExit of a study that a file adds would end the command
        if is_interrupt(error):
            raise KeyboardInterrupt from error
        status, reason = describe_failure(error)
    seconds, cpu = time.perf_counter() - begin, read_cpu_seconds() - spent
    return Outcome(job, status, reason, values, seconds, cpu, peak_megabytes() if job.study.alone else None)
