"""A command as a dataclass: its docstring is the help, its fields are the options, and `run` does the work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, Field, fields, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import click

from ..lhm.base.limits import FACES, SEED, STUDIED_PAIRS, WORKERS, Bound
from ..lhm.base.option import argument, option

__all__ = [
    "FILE",
    "LEVEL",
    "argument",
    "as_command",
    "count_range",
    "make_command",
    "make_option",
    "name_option",
    "option",
    "type_option",
]

FILE = click.Path(path_type=Path)
LEVEL = click.IntRange(1, 3)
COUNTS: dict[str, Bound] = {
    "seed": SEED,
    "level": Bound("level", 3, "templates have three", 1),
    "repeats": Bound("repeats", 1_000, "medians of fewer are as good", 1),
    "rounds": Bound("rounds", 1_000, "medians of fewer are as good", 1),
    "people": Bound("people", 1_000, "each is minutes of work", 1),
    "frames": Bound("frames", 100_000, "each is 0.1 s of work or more", 1),
    "count": Bound("identities", 100_000, "each is a second of work or more", 1),
    "gallery": Bound("heads", 1_000, "each is simulated and drawn"),
    "fan": Bound("starts", 1_000, "each is a solve"),
    "simulated": FACES,
    "generalisation": replace(STUDIED_PAIRS, least=0),
    "workers": WORKERS,
    "up_to": Bound("unknowns", 100_000_000, "a machine of 64 GB holds some ten million", 1),
}
"""The bound of a count by its field's name; where a study itself takes less, it says so."""


def count_range(bound: Bound) -> click.IntRange:
    """Make the type of an option that is such a count; `--help` shows the range."""
    return click.IntRange(bound.least, bound.most)


class Request(Protocol):
    """What a command was asked for; `run` does it and returns the exit status."""

    def __init__(self, **options: Any) -> None: ...

    def run(self) -> int:
        """Do it."""


Kind = TypeVar("Kind", bound=type[Request])


def as_command(group: click.Group, name: str) -> Callable[[Kind], Kind]:
    """Give a group the command that a dataclass describes; a decorator."""

    def add(kind: Kind) -> Kind:
        group.add_command(make_command(name, kind))
        return kind

    return add


def make_command(name: str, kind: type[Request]) -> click.Command:
    """Make the command that a dataclass describes."""

    def run(**options: Any) -> int:
        return kind(**options).run()

    params = [make_option(field) for field in fields(kind)]  # type: ignore[arg-type]  # a dataclass
    return click.Command(name, params=params, callback=run, help=kind.__doc__)


def make_option(field: Field, *, repeats: bool = False, **more: Any) -> click.Parameter:
    """Make the option or argument of a dataclass' field; `more` words go before those of the field."""
    words = dict(field.metadata)
    shown = words.pop("argument", None)
    if shown is not None:
        count = -1 if isinstance(field.default, tuple) else 1
        required = field.default is MISSING
        return click.Argument([field.name], metavar=shown, required=required, nargs=count, type=words["type"])
    names = [name_option(field), field.name]
    words = {key: value for key, value in words.items() if key != "name"} | more
    if not words.get("required"):
        words.setdefault("default", field.default)
    if field.default is False:
        return click.Option(names, is_flag=True, **words)
    if repeats or isinstance(field.default, tuple):
        return click.Option(names, multiple=True, **words)
    return click.Option(names, **words | {"type": type_option(field)})


def name_option(field: Field) -> str:
    """Name the option of a field, as --json; of several values by the singular."""
    plain = "--" + field.name.replace("_", "-")
    name: str = field.metadata.get("name", plain.removesuffix("s") if isinstance(field.default, tuple) else plain)
    return name


def type_option(field: Field) -> Any:
    """Give the click type of an option's values."""
    is_count = field.name in COUNTS and type(field.default) is int
    return field.metadata.get("type", count_range(COUNTS[field.name]) if is_count else type(field.default))
