"""Progress on stderr."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from ..lhm.base.progress import OnProgress


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
