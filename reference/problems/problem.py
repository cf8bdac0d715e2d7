"""A verification problem as data, and what a solver makes of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from ..added import added_solvers
from ..scene import Scene
from ..solution import Reason, Solution
from ..solve import solve

TOLERANCE = 1e-11
"""The relative gradient norm that problems are solved to."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene, a quantity of its solution, and the value that it must have.

    `bounds` gives, for each solver that models the scene, the largest error that passes: relative to the reference,
    or absolute where that is 0. `start` gives positions [mm] to start from, default rest; `options`
    are the solver's, such as its element; `reason` is why the solver should stop.
    """

    name: str
    source: str
    scene: Callable[[], Scene]
    quantity: Callable[[Scene, Solution], float]
    reference: float
    bounds: Mapping[str, float]
    start: Callable[[Scene], Floats] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    tolerance: float = TOLERANCE
    reason: Reason = Reason.CONVERGED

    @property
    def solvers(self) -> tuple[str, ...]:
        """The solvers that model the problem, and those that files have added, which say themselves if they do not."""
        return (*self.bounds, *(() if self.options else added_solvers()))

    def bound(self, solver: str) -> float:
        """The largest error that passes; of a solver that a file has added, the largest of any."""
        return self.bounds.get(solver, max(self.bounds.values()))


@dataclass(frozen=True)
class Outcome:
    """One solver's result of one problem: value and error against the reference, and what it took.

    `passed` means that the solver converged and the error is within the bound; `reason` says why it stopped.
    """

    problem: str
    source: str
    solver: str
    value: float
    reference: float
    error: float
    bound: float
    passed: bool
    reason: str
    seconds: float
    iterations: int


def run(problem: Problem, solver: str) -> Outcome:
    """Solve a problem, preparation included in the seconds.

    Raises SceneError for a solver that does not model it, MissingDependencyError if its packages are not installed.
    """
    if solver not in problem.solvers:
        raise SceneError(
            f"problem {problem.name!r} is not for solver {solver!r}; it is for {', '.join(problem.solvers)}"
        )
    scene = problem.scene()
    start = None if problem.start is None else problem.start(scene)
    begin = time.perf_counter()
    solution = solve(scene, solver=solver, start=start, tolerance=problem.tolerance, **problem.options)
    seconds = time.perf_counter() - begin
    value, reference = float(problem.quantity(scene, solution)), float(problem.reference)
    error = abs(value - reference) / (abs(reference) or 1.0)
    bound = problem.bound(solver)
    return Outcome(
        problem.name,
        problem.source,
        solver,
        value,
        reference,
        error,
        bound,
        solution.reason is problem.reason and error <= bound,
        solution.reason.name,
        seconds,
        solution.iterations,
    )
