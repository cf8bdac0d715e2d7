"""How a call ended: taken, refused in a line, or a defect, within bounds of work, time and memory."""

from __future__ import annotations

import faulthandler
import resource
import signal
import traceback
from collections.abc import Callable
from pathlib import Path

from softdeca.lhm import SoftdecaError

PLAIN = (TypeError, ValueError, AttributeError)
"""How numpy and Python refuse an argument of another kind."""


class TooLong(BaseException):
    """A call had its time; not an Exception, so that nothing on its way catches it."""


def bound_memory(more: int) -> None:
    """Let this process' address space grow by that many bytes from here on."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + more, used + more))


def watch(call: Callable[[], object], *, seconds: float, patience: float, plain: bool = False) -> tuple[str, str]:
    """Call it, for so many seconds of work and of time at most, since a busy machine takes many for one of work.

    Returns "accepted", "refused" (by a SoftdecaError of one line) or what else it ended with, and the words it said;
    "refused plainly" where numpy or Python refused an argument, if `plain` lets them.
    """
    signal.signal(signal.SIGALRM, _end)
    signal.signal(signal.SIGPROF, _end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, patience)
    faulthandler.dump_traceback_later(2 * patience, exit=True)  # where only C code runs
    try:
        call()
        return "accepted", ""
    except SoftdecaError as error:
        said = str(error)
        return ("refused" if said and "\n" not in said else "refused in other than one line"), said
    except PLAIN as error:
        return "refused plainly" if plain else "traceback", _told(error)
    except TooLong:
        return "hang", f"no end after {seconds} s of work or {patience} s"
    except BaseException as error:
        return "traceback", _told(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        faulthandler.cancel_dump_traceback_later()


def _told(error: BaseException) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {str(error)[:200]!r} at {where.filename}:{where.lineno}"


def _end(*_: object) -> None:
    raise TooLong
