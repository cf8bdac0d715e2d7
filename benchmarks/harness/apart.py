"""Work in a fresh process, where its memory can be told from that of what ran before."""

from __future__ import annotations

import multiprocessing
import resource
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TypeVar

from ...lhm.base.errors import SoftdecaError

Result = TypeVar("Result")

MEGABYTE = 1e6


def apart(work: Callable[..., Result], *arguments) -> Result:
    """What `work`, a function of a module, returns in a spawned process; arguments and result travel by pickle.

    Raises what `work` raises, and SoftdecaError if the process dies, as for want of memory.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(work, *arguments).result()
        except BrokenProcessPool:
            raise SoftdecaError(f"{work.__module__}.{work.__qualname__}: its process died") from None


def cpu_seconds() -> float:
    """Processor time [s] of this process, and of those it has started that have ended."""
    own, ended = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + ended.ru_utime + ended.ru_stime


def peak_megabytes() -> float:
    """The most memory [MB] that this process has held since its start, or since `forget_peak`."""
    # Not ru_maxrss alone: through exec it keeps what the parent held.
    found = _status("VmHWM")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MEGABYTE if found is None else found


def held_megabytes() -> float:
    """The memory [MB] that this process holds now; where the system does not say, the most it has held."""
    found = _status("VmRSS")
    return peak_megabytes() if found is None else found


def forget_peak() -> None:
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
