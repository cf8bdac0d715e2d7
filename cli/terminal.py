"""What a terminal shows and sends: progress on stderr, and Ctrl-C."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from ..lhm.base.errors import is_interrupt
from ..lhm.base.progress import OnProgress

INTERRUPTED = 130
"""Exit status: 128 and the number of SIGINT, as shells have it."""


@contextmanager
def show_progress() -> Iterator[OnProgress]:
    """Give a callback (stage, fraction) that shows how far long work is: bars on a terminal, lines elsewhere.

    Of "stage: detail" the stage is timed.
    """
    if not sys.stderr.isatty():
        yield _Lines()
        return
    columns = (TextColumn("{task.description:<56}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        yield _Bars(bars)


class _Bars:
    def __init__(self, bars: Progress):
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, what: str, fraction: float) -> None:
        stage = what.partition(": ")[0]
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(what, total=1.0)
        self._bars.update(self._tasks[stage], completed=min(fraction, 1.0), description=what)


class _Lines:
    def __init__(self):
        self._begun: dict[str, float] = {}
        self._said: dict[str, float] = {}

    def __call__(self, what: str, fraction: float) -> None:
        now, stage = time.monotonic(), what.partition(": ")[0]
        self._begun.setdefault(stage, now)
        if fraction < 1.0 and now - self._said.get(stage, -1e9) < 0.5:
            return
        self._said[stage] = now
        seconds = now - self._begun[stage]
        print(f"{what}: {100 * min(fraction, 1.0):.0f} % ({seconds:.0f} s)", file=sys.stderr, flush=True)


@contextmanager
def end_at_ctrl_c() -> Iterator[None]:
    """Raise KeyboardInterrupt at the first Ctrl-C within, and end the process at the second.

    A second KeyboardInterrupt would cut off what cleans up after the first: files stay half-written, and libraries that
    draw are left between two of their calls, which ended in a crash. A first one inside a callback from C, which cannot
    pass it on, ends the process, too. Where somebody has decided otherwise about SIGINT, as nohup has, nothing is
    changed. After a Ctrl-C this stays so until the process ends.
    """
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    interrupted = False

    def first(*_) -> None:
        nonlocal interrupted
        interrupted = True
        signal.signal(signal.SIGINT, _end_at_once)
        raise KeyboardInterrupt

    def end_if_interrupted(swallowed: Any) -> None:
        if interrupted and swallowed.exc_value is not None and is_interrupt(swallowed.exc_value):
            _end_at_once()
        tell(swallowed)

    tell, sys.unraisablehook = sys.unraisablehook, end_if_interrupted
    signal.signal(signal.SIGINT, first)
    try:
        yield
    finally:
        sys.unraisablehook = tell
        if not interrupted:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _end_at_once(*_) -> None:
    os.write(2, b"softdeca: interrupted; ended at once\n")
    os._exit(INTERRUPTED)
