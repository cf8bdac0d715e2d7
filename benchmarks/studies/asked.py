"""Checks of what studies are asked for."""

from __future__ import annotations

from collections.abc import Sequence

from ...lhm.base.errors import InputError
from ...lhm.template import LEVELS
from ...reference.added import all_solvers


def solvers_asked(solvers: Sequence[str]) -> tuple[str, ...]:
    """These, or all where none is named; InputError for an unknown one."""
    for solver in solvers:
        if solver not in all_solvers():
            raise InputError(f"unknown solver {solver!r}; there are {', '.join(all_solvers())}")
    return tuple(solvers) or all_solvers()


def check_person(seed: int, level: int) -> None:
    """InputError for a negative seed, and for a level that the default template has not."""
    if seed < 0:
        raise InputError(f"seed: must be at least 0, got {seed}")
    if level not in LEVELS:
        raise InputError(f"level: there are {', '.join(map(str, LEVELS))}, got {level}")
