"""Which solvers a study asks."""

from __future__ import annotations

from collections.abc import Sequence

from ...lhm.errors import InputError
from ...reference import SOLVERS


def asked(solvers: Sequence[str]) -> tuple[str, ...]:
    """These, or all where none is named; InputError for an unknown one."""
    for solver in solvers:
        if solver not in SOLVERS:
            raise InputError(f"unknown solver {solver!r}; there are {', '.join(SOLVERS)}")
    return tuple(solvers) or SOLVERS
