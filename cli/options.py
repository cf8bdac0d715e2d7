"""A command as a dataclass: its docstring is the help, its fields are the options, and `run` does the work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, TypeVar

import click

from ..lhm.base.limits import Bound
from ..lhm.base.option import argument, option

__all__ = [
    "FILE",
    "LEVEL",
    "FloatRange",
    "argument",
    "as_command",
    "count_range",
    "list_options",
    "make_command",
    "make_option",
    "option",
    "refuse_unread",
]

FILE = click.Path(path_type=Path)
LEVEL = click.IntRange(1, 3)
_OURS = ("argument", "bound", "name")
"""Metadata of a field that click does not know."""


def count_range(bound: Bound) -> click.IntRange:
    """Make the type of an option that is such a count; `--help` shows the range."""
    return click.IntRange(bound.least, bound.most)


Kind = TypeVar("Kind", bound=type[Any])
"""A dataclass of options; `run` does the command and returns the exit status."""


def as_command(group: click.Group, name: str) -> Callable[[Kind], Kind]:
    """Give a group the command that a dataclass describes; a decorator."""

    def add(kind: Kind) -> Kind:
        group.add_command(make_command(name, kind))
        return kind

    return add


def make_command(name: str, kind: type[Any]) -> click.Command:
    """Make the command that a dataclass describes."""

    def run(**options: Any) -> int:
        status: int = kind(**options).run()
        return status

    params = [make_option(field) for field in list_options(kind)]
    return click.Command(name, params=params, callback=run, help=kind.__doc__)


def list_options(kind: type) -> list[Field]:
    """List the fields of a dataclass that are options or arguments; others are values that only Python gives."""
    return [field for field in fields(kind) if field.metadata]


def make_option(field: Field, **more: Any) -> click.Parameter:
    """Make the option or argument of a dataclass' field; `more` words go before those of the field."""
    words = {key: value for key, value in field.metadata.items() if key not in _OURS} | more
    shown = field.metadata.get("argument")
    if shown is not None:
        form: dict[str, Any] = {"metavar": shown, "type": words["type"]}
        if isinstance(field.default, tuple):
            return click.Argument([field.name], required=False, nargs=-1, **form)
        default = {} if field.default is MISSING else {"default": field.default}
        return click.Argument([field.name], required=not default, **default, **form)
    names = [name_option(field), field.name]
    if not words.get("required"):
        words.setdefault("default", field.default)
    if field.default is False:
        return click.Option(names, is_flag=True, **words)
    if isinstance(field.default, tuple):
        return click.Option(names, multiple=True, **words)
    return click.Option(names, **words | {"type": type_option(field)})


def refuse_unread(options: Any, because: str, *names: str) -> None:
    """Raise click's usage error for the first of a command's options that is given though nothing would read it."""
    for field in list_options(type(options)):
        # A path that click made of a default's text is not given.
        if field.name in names and str(getattr(options, field.name)) != str(field.default):
            words = f"{name_option(field)}: nothing reads it {because}; leave it out"
            raise click.UsageError(words, click.get_current_context())


class FloatRange(click.FloatRange):
    """Numbers within a range; click's own takes NaN for one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        number = super().convert(value, param, ctx)
        if number != number:
            self.fail(f"{value!r} is no number", param, ctx)
        return float(number)


def name_option(field: Field) -> str:
    """Name the option of a field, as --json; of several values by the singular."""
    plain = "--" + field.name.replace("_", "-")
    name: str = field.metadata.get("name", plain.removesuffix("s") if isinstance(field.default, tuple) else plain)
    return name


def type_option(field: Field) -> Any:
    """Give the click type of an option's values."""
    bound = field.metadata.get("bound")
    return field.metadata.get("type", type(field.default)) if bound is None else count_range(bound)
