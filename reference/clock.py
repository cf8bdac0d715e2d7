"""Time that goes into making code, told apart from time that goes into an answer.

numba compiles a kernel and FEniCSx a form when it is first needed, or loads it from a cache on disk. Both happen once
per process and kind of scene, wherever in a preparation or a solve that is.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from numba.core import event


@dataclass(frozen=True)
class Seconds:
    """Seconds of work, and of compilation beside it."""

    work: float
    compilation: float


class _Compilers(event.Listener):
    """Adds up the time [s] in which this process compiles or loads code; what is nested counts once."""

    def __init__(self):
        self.seconds, self._depth, self._begin = 0.0, 0, 0.0

    def on_start(self, _event):
        if self._depth == 0:
            self._begin = time.perf_counter()
        self._depth += 1

    def on_end(self, _event):
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._begin


_compilers = _Compilers()
event.register("numba:compiler_lock", _compilers)


@contextmanager
def count_compilation() -> Iterator[None]:
    """What another compiler than numba's does within counts as compilation."""
    _compilers.on_start(None)
    try:
        yield
    finally:
        _compilers.on_end(None)


class Clock:
    """Measures from when it is made."""

    def __init__(self):
        self._begin, self._compiled = time.perf_counter(), _compilers.seconds

    def read(self) -> Seconds:
        """What has passed since."""
        compilation = _compilers.seconds - self._compiled
        return Seconds(time.perf_counter() - self._begin - compilation, compilation)

    def pause(self, seconds: float):
        """Leave out so much of what has passed."""
        self._begin += seconds
