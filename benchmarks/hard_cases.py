"""Every hard case through every solver that it is for."""

from __future__ import annotations

from dataclasses import asdict

from ..lhm.errors import InputError, MissingDependencyError
from ..lhm.progress import OnProgress
from ..reference import SOLVERS, problems


def try_hard_cases(
    progress: OnProgress, *, solvers: tuple[str, ...] = SOLVERS, match: str = "", laws: bool = False
) -> list[dict]:
    """Run the cases whose name or source has `match` in it; a row is a `problems.HardOutcome` with its `passed`.

    With `laws` those of every law on every element of FEniCSx too. A solver whose packages are missing is left out if
    others were asked for too. Raises InputError for an unknown solver, or if nothing matches.
    """
    unknown = [solver for solver in solvers if solver not in SOLVERS]
    if unknown:
        raise InputError(f"unknown solver {unknown[0]!r}; there are {', '.join(SOLVERS)}")
    posed = (*problems.HARD, *problems.LAWS_ON_ELEMENTS) if laws else problems.HARD
    found = [case for case in posed if match.lower() in f"{case.source} {case.name}".lower()]
    ways = [(case, *way) for case in found for way in case.ways if way[0] in solvers]
    if not ways:
        raise InputError(f"no hard case matches {match!r} for {', '.join(solvers)}")
    rows = []
    for i, (case, solver, element) in enumerate(ways):
        progress(f"hard cases: {case.name}, {solver}, {element}", i / len(ways))
        try:
            outcome = problems.run_hard(case, solver, element)
            rows.append(asdict(outcome) | {"passed": outcome.passed})
        except MissingDependencyError:
            if len(solvers) == 1:
                raise
    progress("hard cases", 1.0)
    return rows
