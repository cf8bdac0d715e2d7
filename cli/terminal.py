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
        yield _write_lines()
        return
    columns = (TextColumn("{task.description:<56}"), BarColumn(), TimeElapsedColumn())
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=Console(stderr=True)) as bars:

        def show(what: str, fraction: float) -> None:
            stage = what.partition(": ")[0]
            if stage not in tasks:
                tasks[stage] = bars.add_task(what, total=1.0)
            bars.update(tasks[stage], completed=min(fraction, 1.0), description=what)

        yield show


def _write_lines() -> OnProgress:
    begun: dict[str, float] = {}
    last: dict[str, float] = {}

    def show(what: str, fraction: float) -> None:
        now, stage = time.monotonic(), what.partition(": ")[0]
        begun.setdefault(stage, now)
        if fraction < 1.0 and now - last.get(stage, -1e9) < 0.5:
            return
        last[stage] = now
        seconds = now - begun[stage]
        print(f"{what}: {100 * min(fraction, 1.0):.0f} % ({seconds:.0f} s)", file=sys.stderr, flush=True)

    return show
