"""Every hard case through every solver that it is for."""

from __future__ import annotations

from dataclasses import asdict

from ..lhm.errors import InputError, MissingDependencyError
from ..lhm.progress import OnProgress
from ..reference import SOLVERS, problems


def try_hard_cases(progress: OnProgress, *, solvers: tuple[str, ...] = SOLVERS, match: str = "") -> list[dict]:
    """Run the cases whose name or source has `match` in it; a row has the fields of `problems.HardOutcome`.

    A solver whose packages are missing is left out if others were asked for too. Raises InputError for an unknown
    solver, or if nothing matches.
    """
    unknown = [solver for solver in solvers if solver not in SOLVERS]
    if unknown:
        raise InputError(f"unknown solver {unknown[0]!r}; there are {', '.join(SOLVERS)}")
    found = [case for case in problems.HARD if match.lower() in f"{case.source} {case.name}".lower()]
    pairs = [(case, solver) for case in found for solver in solvers if solver in case.solvers]
    if not pairs:
        raise InputError(f"no hard case matches {match!r} for {', '.join(solvers)}")
    rows = []
    for i, (case, solver) in enumerate(pairs):
        progress(f"hard cases: {case.name}, {solver}", i / len(pairs))
        try:
            rows.append(asdict(problems.run_hard(case, solver)))
        except MissingDependencyError:
            if len(solvers) == 1:
                raise
    progress("hard cases", 1.0)
    return rows
