"""Progress on stderr: a bar on a terminal, a line per step elsewhere."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ..lhm.progress import OnProgress


@contextmanager
def shown() -> Iterator[OnProgress]:
    """A callback (what, fraction) that shows how far long work is."""
    if sys.stderr.isatty():
        columns = (TextColumn("{task.description:<48}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True), transient=False) as bars:
            tasks: dict[str, int] = {}

            def draw(what: str, fraction: float) -> None:
                if what not in tasks:
                    tasks[what] = bars.add_task(what, total=1.0)
                bars.update(tasks[what], completed=min(fraction, 1.0))  # type: ignore[arg-type]

            yield draw
        return
    begun: dict[str, float] = {}
    said: dict[str, int] = {}

    def say(what: str, fraction: float) -> None:
        now = time.monotonic()
        begun.setdefault(what, now)
        quarter = int(4 * fraction)
        if quarter > said.get(what, -1):
            said[what] = quarter
            print(f"{what}: {25 * quarter} % ({now - begun[what]:.0f} s)", file=sys.stderr, flush=True)

    yield say
