"""Counts on the command line, within the bounds that functions have: `--help` shows the range."""

import click

from ..lhm.base.limits import Bound


def counted(bound: Bound, *, least: int | None = None) -> click.IntRange:
    """Return the type of an option that is such a count, from `least` on where that is more than the bound's own."""
    return click.IntRange(bound.least if least is None else least, bound.most)
