"""Every verification problem through every solver that models it."""

from __future__ import annotations

from dataclasses import asdict

from ..lhm.errors import InputError, MissingDependencyError
from ..lhm.progress import OnProgress
from ..reference import SOLVERS, problems


def verify(progress: OnProgress, *, solvers: tuple[str, ...] = SOLVERS) -> list[dict]:
    """Run the problems; a row per problem and solver has the fields of `problems.Outcome`.

    A solver whose packages are missing is left out if others were asked for too. Raises InputError for an unknown one.
    """
    unknown = [solver for solver in solvers if solver not in SOLVERS]
    if unknown:
        raise InputError(f"unknown solver {unknown[0]!r}; there are {', '.join(SOLVERS)}")
    pairs = [(problem, solver) for problem in problems.ALL for solver in solvers if solver in problem.solvers]
    rows = []
    for i, (problem, solver) in enumerate(pairs):
        progress(f"verification: {problem.name}, {solver}", i / len(pairs))
        try:
            rows.append(asdict(problems.run(problem, solver)))
        except MissingDependencyError:
            if len(solvers) == 1:
                raise
    progress("verification", 1.0)
    return rows
