"""Standard streams that are closed, or whose reader has gone, as in `2>&-` and `| head`."""

import os
import sys
from contextlib import suppress


def open_closed_streams() -> None:
    """Open the null device in place of each standard stream that is closed.

    A file opened later would else take its number, and a library's messages would be written into that file.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "r" if number == 0 else "w", closefd=False))  # noqa: SIM115


def silence_streams(*numbers: int) -> None:
    """Send what is still to be written to these streams nowhere: Python's last flush would fail, and tell it."""
    for number in numbers:
        with suppress(OSError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, number)
            os.close(null)
