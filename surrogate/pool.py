"""Work over many items by several processes that end together: done, failed, interrupted, or with their parent."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from multiprocessing.util import Finalize
from typing import Any, TypeVar

from ..lhm.errors import SoftdecaError

Item = TypeVar("Item")
Result = TypeVar("Result")


def nothing() -> None:
    """What a process does before its first item, by default."""


def results_of(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int,
    name: str,
    begin: Callable[[], object] = nothing,
) -> Iterator[Result]:
    """What `work` makes of each item, in the order in which it is done.

    With one worker, or one item, in this process; else in spawned ones, to which `work` and `begin` travel once, by
    pickle. `begin` is called in each process before its first item. Raises what `work` raises, and SoftdecaError
    naming `name` if a worker dies. No worker outlives the iterator, nor this process, however they end; a file that
    a stopped worker was writing by `replaced` is removed.
    """
    count = min(workers, len(items))
    if count == 0:
        return
    if count == 1:
        begin()
        yield from map(work, items)
        return
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _Worker.start, (work, begin))
    try:
        # Workers inherit what is blocked while they are started: Ctrl-C reaches every process of a terminal, but the
        # parent alone decides, and ends its workers by SIGTERM.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            futures = [pool.submit(_Worker.run, item) for item in items]
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool:
        raise SoftdecaError(f"{name}: a worker process died; run again to go on where it stopped") from None
    except BaseException:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        # The pool itself cancels what waits: its thread fails on a future that was cancelled by somebody else.
        pool.shutdown(cancel_futures=True)


class _Worker:
    """What a worker process keeps between items."""

    work: Callable[[Any], Any]
    begin: Callable[[], object]
    stopped = False

    @classmethod
    def start(cls, work: Callable[[Any], Any], begin: Callable[[], object]):
        cls.work, cls.begin = work, begin
        threading.Thread(target=cls._end_with_parent, daemon=True).start()
        # A worker that is done leaves at once: its process object holds the work to the interpreter's end, where the
        # solvers in it complain on stderr of being left.
        Finalize(None, os._exit, args=(0,), exitpriority=-10)

    @staticmethod
    def _end_with_parent():
        # A parent that is killed outright can stop nobody.
        parent = multiprocessing.parent_process()
        if parent is not None:
            wait([parent.sentinel])
            os._exit(1)

    @classmethod
    def run(cls, item):
        try:
            return cls._run(item)
        finally:
            if cls.stopped:
                os._exit(1)

    @classmethod
    def _run(cls, item):
        try:
            signal.signal(signal.SIGTERM, cls._stop)
            begin, cls.begin = cls.begin, nothing
            begin()
            return cls.work(item)
        finally:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)

    @classmethod
    def _stop(cls, *_):
        # The first SIGTERM unwinds what runs, so that a file that is being written is removed; the pool sends more.
        if not cls.stopped:
            cls.stopped = True
            raise SystemExit(1)
