"""Verification problems and hard cases as data, and the results of solvers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from ..added import Problem, added_solvers
from ..scene import Scene
from ..solution import Reason, Solution
from ..solve import Prepared, prepare, solve

EVERY_SOLVER = ("projective", "fenicsx", "skfem")
HARD_TOLERANCE = 1e-10
"""The relative gradient norm that hard cases are solved to, unless they say otherwise."""


mixed_problem = partial(Problem, options={"element": "P2P1"}, tolerance=1e-9)
"""A problem for Taylor-Hood's element."""


def energy(scene: Scene, solution: Solution) -> float:
    """The energy [µJ], which for the unit cube is the density [kPa]."""
    return solution.energy


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
    ended = Reason.CONVERGED if solution.reason is Reason.ROUNDING else solution.reason
    return Outcome(
        problem.name,
        problem.source,
        solver,
        value,
        reference,
        error,
        bound,
        ended is problem.reason and error <= bound,
        solution.reason.name,
        seconds,
        solution.iterations,
    )


@dataclass
class Attempt:
    """One solver at one case: it counts iterations and remembers the first reason to stop other than convergence.

    `element` is FEniCSx's; the other solvers have linear ones.
    """

    solver: str
    element: str = "P1"
    iterations: int = field(default=0, init=False)
    stopped: Reason | None = field(default=None, init=False)

    @property
    def options(self) -> dict[str, Any]:
        """The solver's options."""
        return {"element": self.element} if self.solver == "fenicsx" else {}

    def prepare(self, scene: Scene) -> Prepared:
        """Prepare a scene."""
        return prepare(scene, solver=self.solver, **self.options)

    def solve(
        self,
        prepared: Prepared,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = HARD_TOLERANCE,
    ) -> Solution:
        """Solve a prepared scene, or one that differs from it as `Prepared.solve` allows."""
        return self.count(prepared.solve(scene, start=start, tolerance=tolerance))

    def count(self, solution: Solution) -> Solution:
        """Add a solution's iterations, and keep why it stopped if it is the first that did not converge."""
        self.iterations += solution.iterations
        if not solution.is_balanced and self.stopped is None:
            self.stopped = solution.reason
        return solution


@dataclass(frozen=True, eq=False)
class HardCase:
    """Something hard to solve, judged by being right.

    `error` sets it up, solves it, and says how far off the answer is; it passes if every solve converged and the error
    is at most `bound`. `criterion` says in words what is compared, `source` where case and value come from. `elements`
    are FEniCSx's that it is for. `right` are the outcomes that are no fault (see HardOutcome).
    """

    name: str
    source: str
    criterion: str
    error: Callable[[Attempt], float]
    bound: float
    solvers: tuple[str, ...]
    elements: tuple[str, ...] = ("P1",)
    right: tuple[str, ...] = ("passed",)

    @property
    def ways(self) -> tuple[tuple[str, str], ...]:
        """Every solver that the case is for, with each element that it is for.

        Those that files have added try what linear tets can do, and say themselves which scenes they cannot model.
        """
        ways = tuple((s, e) for s in self.solvers for e in (self.elements if s == "fenicsx" else ("P1",)))
        for_all = self.elements == ("P1",) and self.right == ("passed",)
        return (*ways, *((s, "P1") for s in added_solvers() if for_all))


@dataclass(frozen=True)
class HardOutcome:
    """One solver's result of one case.

    `outcome` is "passed"; "missed" for an answer that is off, such as an equilibrium that is not the one sought; or the
    name of the reason it stopped.
    """

    case: str
    source: str
    criterion: str
    solver: str
    element: str
    outcome: str
    right: tuple[str, ...]
    error: float
    bound: float
    iterations: int
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether the outcome is no fault."""
        return self.outcome in self.right


def run_hard(case: HardCase, solver: str, element: str = "P1") -> HardOutcome:
    """Try a case, preparation included in the seconds.

    Raises SceneError for a solver or element that the case is not for, MissingDependencyError if the solver's packages
    are not installed.
    """
    solvers = dict(case.ways)
    if solver not in solvers:
        raise SceneError(f"hard case {case.name!r} is not for solver {solver!r}; it is for {', '.join(solvers)}")
    if (solver, element) not in case.ways:
        names = ", ".join(its_element for s, its_element in case.ways if s == solver)
        raise SceneError(f"hard case {case.name!r} is not for element {element!r}; it is for {names}")
    attempt = Attempt(solver, element)
    begin = time.perf_counter()
    error = case.error(attempt)
    seconds = time.perf_counter() - begin
    outcome = "passed" if error <= case.bound else "missed"
    if attempt.stopped is not None and not (attempt.stopped.name in case.right and case.bound < error < np.inf):
        outcome = attempt.stopped.name
    return HardOutcome(
        case.name,
        case.source,
        case.criterion,
        solver,
        element,
        outcome,
        case.right,
        error,
        case.bound,
        attempt.iterations,
        seconds,
    )
