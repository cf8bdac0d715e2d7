"""A hard case as data: what is tried, what counts as right, and what a solver makes of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ...lhm.errors import SceneError
from ...lhm.mesh import Floats
from ..scene import Scene
from ..solution import Reason, Solution
from ..solve import Prepared, prepare

TOLERANCE = 1e-10
"""The relative gradient norm that hard cases are solved to, unless they say otherwise."""


@dataclass
class Attempt:
    """One solver at one case: it counts iterations and remembers the first reason to stop other than convergence."""

    solver: str
    iterations: int = field(default=0, init=False)
    stopped: Reason | None = field(default=None, init=False)

    def prepare(self, scene: Scene) -> Prepared:
        """Prepare a scene."""
        return prepare(scene, solver=self.solver)

    def solve(
        self,
        prepared: Prepared,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = TOLERANCE,
    ) -> Solution:
        """Solve a prepared scene, or one that differs from it as `Prepared.solve` allows."""
        solution = prepared.solve(scene, start=start, tolerance=tolerance)
        self.iterations += solution.iterations
        if not solution.converged and self.stopped is None:
            self.stopped = solution.reason
        return solution


@dataclass(frozen=True, eq=False)
class HardCase:
    """Something hard to solve, judged by being right.

    `error` sets it up, solves it, and says how far off the answer is; it passes if every solve converged and the error
    is at most `bound`. `criterion` says in words what is compared, `source` where case and value come from.
    """

    name: str
    source: str
    criterion: str
    error: Callable[[Attempt], float]
    bound: float
    solvers: tuple[str, ...]


@dataclass(frozen=True)
class HardOutcome:
    """What one solver made of one case: `outcome` is "passed", "missed", or the name of the reason it stopped."""

    case: str
    source: str
    criterion: str
    solver: str
    outcome: str
    error: float
    bound: float
    iterations: int
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether it converged to what is right."""
        return self.outcome == "passed"


def run_hard(case: HardCase, solver: str) -> HardOutcome:
    """Try a case, preparation included in the seconds.

    Raises SceneError for a solver that the case is not for, MissingDependencyError if its packages are not installed.
    """
    if solver not in case.solvers:
        raise SceneError(f"hard case {case.name!r} is not for solver {solver!r}; it is for {', '.join(case.solvers)}")
    attempt = Attempt(solver)
    begin = time.perf_counter()
    error = case.error(attempt)
    seconds = time.perf_counter() - begin
    outcome = "passed" if error <= case.bound else "missed"
    if attempt.stopped is not None:
        outcome = attempt.stopped.name
    return HardOutcome(
        case.name, case.source, case.criterion, solver, outcome, error, case.bound, attempt.iterations, seconds
    )
