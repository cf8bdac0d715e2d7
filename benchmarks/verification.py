"""Every verification problem through every solver that models it."""

from __future__ import annotations

from dataclasses import asdict

from ..lhm.errors import InputError, MissingDependencyError
from ..lhm.progress import OnProgress
from ..reference import SOLVERS, problems


def verify(progress: OnProgress, *, solvers: tuple[str, ...] = SOLVERS, fine: bool = False) -> list[dict]:
    """Run the problems; a row per problem and solver has the fields of `problems.Outcome`.

    With `fine` there follow, for FEniCSx, the published problems on finer meshes, its elements' orders of convergence
    and their locking as Poisson's ratio nears one half: a quarter of an hour.
    A solver whose packages are missing is left out if others were asked for too. Raises InputError for an unknown one.
    """
    unknown = [solver for solver in solvers if solver not in SOLVERS]
    if unknown:
        raise InputError(f"unknown solver {unknown[0]!r}; there are {', '.join(SOLVERS)}")
    posed = (*problems.ALL, *problems.FINE) if fine else problems.ALL
    pairs = [(problem, solver) for problem in posed for solver in solvers if solver in problem.solvers]
    rows = []
    for i, (problem, solver) in enumerate(pairs):
        progress(f"verification: {problem.name}, {solver}", i / len(pairs))
        try:
            rows.append(asdict(problems.run(problem, solver)))
        except MissingDependencyError:
            if len(solvers) == 1:
                raise
    if fine and any(row["solver"] == "fenicsx" for row in rows):
        progress("verification: orders of convergence and locking", 1.0)
        outcomes = [outcome for element in problems.orders.ORDERS for outcome in problems.orders.study(element)]
        outcomes += [outcome for poisson in problems.locking.POISSON for outcome in problems.locking.outcomes(poisson)]
        rows += [asdict(outcome) for outcome in outcomes]
    progress("verification", 1.0)
    return rows
