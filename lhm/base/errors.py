"""Errors that a user can act on: each message names the thing and what was expected of it."""

from __future__ import annotations

import numbers
from typing import Any


def escape(text: str) -> str:
    """Escape characters that cannot be printed, so that a text from a file cannot steer the terminal."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: str) -> str:
    """Make one line of a text: spaces and line ends become one space, control characters are escaped."""
    return escape(" ".join(text.split()))


class SoftdecaError(ValueError):
    """Base of every error that softdeca raises on purpose; it is one line, whatever it quotes."""

    def __str__(self) -> str:
        """Return the message in one line, see `one_line`."""
        return one_line(super().__str__())


class MeshError(SoftdecaError):
    """A mesh is not what it has to be (shape, index range, orientation, manifoldness)."""


class FitError(SoftdecaError):
    """A layered head could not be made from a skin; the message names the gate that failed."""


class InputError(SoftdecaError):
    """A file, name or value from outside is wrong."""


class SceneError(SoftdecaError):
    """A scene, or what a solver is asked to do with it, is inconsistent."""


class MissingDependencyError(SoftdecaError):
    """An optional package is not installed; the message says what to install."""


def is_interrupt(error: BaseException) -> bool:
    """Whether an error is a Ctrl-C, or what compiled code, a library or a clean-up made of one."""
    seen: set[int] = set()
    waiting: list[BaseException | None] = [error]
    while waiting:
        each = waiting.pop()
        if isinstance(each, KeyboardInterrupt):
            return True
        if each is not None and id(each) not in seen:
            seen.add(id(each))
            waiting += [each.__cause__, each.__context__]
    return False


def quote(value: Any, longest: int = 40) -> str:
    """Quote a value in an error: one line of printable characters, at most `longest` of them and three dots."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        if abs(int(value)) < 10**18:  # Python refuses to print more than 4,300 digits
            return f"{int(value):,}"
        return "more than 10^18" if int(value) > 0 else "less than -10^18"
    text = escape(value if isinstance(value, str) else repr(value))
    return text if len(text) <= longest else text[:longest] + "..."
