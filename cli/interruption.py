"""Ctrl-C: the first ends the work in order, the second ends the process at once."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ..lhm.base.files.atomic import remove_unfinished

INTERRUPTED = 130
"""Exit status: 128 and the number of SIGINT, as shells have it."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt at the first Ctrl-C within, and end the process at the second.

    A second KeyboardInterrupt would cut off what cleans up after the first: files stay half-written, and libraries that
    draw are left between two of their calls, which ended in a crash. Where somebody has decided otherwise about SIGINT,
    as nohup has, nothing is changed. After a Ctrl-C this stays so until the process ends.
    """
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    interrupted = False

    def first(*_) -> None:
        nonlocal interrupted
        interrupted = True
        signal.signal(signal.SIGINT, _end)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, first)
    try:
        yield
    finally:
        if not interrupted:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_) -> None:
    remove_unfinished()
    os.write(2, b"softdeca: interrupted twice; ended at once\n")
    os._exit(INTERRUPTED)
