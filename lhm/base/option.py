"""An option of a command: a field of a dataclass that says its default and its help once."""

from __future__ import annotations

from dataclasses import MISSING, field
from typing import Any

from .limits import Bound


def option(default: Any, help: str, *, bound: Bound | None = None, **more: Any) -> Any:
    """Make a dataclass' field that is an option of a command.

    default: value where the option is not given; a tuple may be given repeatedly, False makes a flag. help: the words
    of `--help`. bound: of a count.
    more: `name` of the option, as --json, where it is not the field's; and words of click, such as `type`.
    """
    return field(default=default, metadata={"help": help, "bound": bound, **more})


def argument(shown: str, default: Any = MISSING, **more: Any) -> Any:
    """Make a dataclass' field that is an argument of a command, `shown` so in its usage; required without a default."""
    return field(default=default, metadata={"argument": shown, **more})
