"""Closed forms, published values, motions and hard cases for every solver, and FElupe as one more code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from ...lhm.base.option import option
from ...reference import Reason, problems
from ..harness.study import Column, Row, Study, Task, Values, at_most
from .arena.entrants import list_entrants
from .arena.laws import NEO_HOOKEAN
from .arena.problems import Problem, face
from .arena.runs import run
from .arena.solvers import felupe_newton
from .measures import TIGHT, largest_distance, solve_to_end
from .motions import MOTIONS, run_motion
from .person import parse_solvers, person

HEAD, FELUPE = "neo-Hookean face without its membrane", "felupe"
LEVEL, BUDGET = 1, 60.0
"""Level of heads; [s] of processor time for FElupe's solve."""
HEAD_BOUND = 1e-8
Outcomes = Callable[[], Sequence[problems.Outcome]]


@dataclass(frozen=True)
class Verification(Study):
    """Closed forms, published values, motions, another code on a head; with `fine` orders of convergence too."""

    name = "verification"
    question = "Do the solvers give the answers that are known?"
    needs = ("people", "heads")
    cheap = "Cook's membrane, nu=.3, P2, 8 cells"
    columns = (
        Column("problem", "problem"),
        Column("source", "source"),
        Column("value", "value"),
        Column("reference", "reference"),
        Column("error", "error"),
        Column("bound", "bound"),
        Column("passed", "within"),
        Column("iterations", "iterations", cost=True),
    )

    solvers: tuple[str, ...] = option((), "only these; repeat for several  [all]")
    fine: bool = option(False, "also finer meshes, and orders by FEniCSx")

    def tasks(self) -> Sequence[Task]:
        """List each problem by each solver."""
        solvers = parse_solvers(self.solvers)
        posed = (*_list_problems(), *problems.FINE) if self.fine else _list_problems()
        tasks = [Task(problem.name, solver) for problem in posed for solver in solvers if solver in problem.solvers]
        if "fenicsx" not in solvers:
            return tasks
        # The longest tasks are first, so that no process is left with it while the others have ended.
        motions = [Task(name, "projective") for name in MOTIONS if "projective" in solvers]
        fine = [Task(name, "fenicsx") for name in (_list_fine() if self.fine else ())]
        return [Task(HEAD, FELUPE), *motions, *fine, *tasks]

    def measure(self, task: Task) -> Values:
        """Measure the outcomes of a problem, or of a series of meshes."""
        if task.case == HEAD:
            return {"outcomes": [asdict(compare_felupe(face(LEVEL, membrane=False)))]}
        if task.case in MOTIONS:
            return {"outcomes": [asdict(run_motion(task.case, person(level=LEVEL).head))]}
        fine = _list_fine().get(task.case)
        if fine is not None:
            return {"outcomes": [asdict(outcome) for outcome in fine()]}
        problem = next(p for p in (*_list_problems(), *problems.FINE) if p.name == task.case)
        return {"outcomes": [asdict(problems.run(problem, task.method))]}

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """Give a line for each outcome."""
        outcomes: Sequence[Values] = values["outcomes"]
        return outcomes

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that none is outside its bound."""
        outside = sum(not outcome["passed"] for row in rows for outcome in self.lines(row.values))
        return [at_most("values outside their bound", outside, 0)]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how many there are."""
        outcomes = [outcome for row in rows for outcome in self.lines(row.values)]
        within = sum(outcome["passed"] for outcome in outcomes)
        solvers = sorted({outcome["solver"] for outcome in outcomes})
        return f"{within} of {len(outcomes)} values by {', '.join(solvers)} are within their bounds."


def compare_felupe(problem: Problem) -> problems.Outcome:
    """Compare FElupe's answer with FEniCSx': largest distance over the largest displacement [mm].

    Raises MissingDependencyError without FElupe, SoftdecaError where it gives no answer.
    """
    scene = problem.scene(NEO_HOOKEAN)
    truth = solve_to_end(scene, "FEniCSx", solver="fenicsx", tolerance=TIGHT)
    entrant = next(each for each in list_entrants() if each.solver == felupe_newton.TITLE)
    found = run(entrant, problem, NEO_HOOKEAN, [truth.positions], BUDGET, scene.vertices)
    moved = largest_distance(truth.positions, scene.vertices)
    error = (np.inf if found["max_mm"] is None else found["max_mm"]) / moved
    return problems.Outcome(
        HEAD, "an independent code: FElupe (PyPI); reference: FEniCSx", FELUPE, moved, moved, error, HEAD_BOUND,
        error <= HEAD_BOUND, found["ended"] or Reason.CONVERGED.name, found["wall_s"], found["iterations"],
    )  # fmt: skip


def _list_problems() -> Sequence[problems.Problem]:
    return (*problems.ALL, *problems.added_problems())


def _list_fine() -> Mapping[str, Outcomes]:
    rates, orders = problems.manufactured.rates, problems.manufactured.ORDERS
    return {f"orders of {element}": partial(rates, element) for element in orders}


@dataclass(frozen=True)
class Hard(Study):
    """Random starts, collapse, crush, twist, slivers, long steps."""

    name = "hard"
    question = "Do the solvers survive hard cases?"
    cheap = "bar twisted by 360° at nu = .49: volume (H6)"
    columns = (
        Column("criterion", "what is compared"),
        Column("outcome", "outcome"),
        Column("error", "error"),
        Column("bound", "bound"),
        Column("passed", "no fault"),
        Column("iterations", "iterations", cost=True),
    )

    solvers: tuple[str, ...] = option((), "only these; repeat for several  [all]")

    def tasks(self) -> Sequence[Task]:
        """List each case by each solver, and element, that it is for."""
        solvers = parse_solvers(self.solvers)
        return [task for task, (_, solver, _) in self._list_ways().items() if solver in solvers]

    def _list_ways(self) -> Mapping[Task, tuple[problems.HardCase, str, str]]:
        return {
            Task(f"{case.name} ({case.source.split(';')[0]})", f"{solver} {element}"): (case, solver, element)
            for case in problems.HARD
            for solver, element in case.ways
        }

    def measure(self, task: Task) -> Values:
        """Measure the outcome; no error of what was refused, or came to nothing near the answer."""
        outcome = problems.run_hard(*self._list_ways()[task])
        error = outcome.error if np.isfinite(outcome.error) else None
        return asdict(outcome) | {"passed": outcome.passed, "error": error}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that no case is missed, or ended for another reason than it may."""
        return [at_most("cases with a fault", sum(not row.values["passed"] for row in rows), 0)]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how many are right, how many stopped for a reason that is right to name or for another, and the rest."""
        right = sum(row.values["outcome"] == "passed" for row in rows)
        passed = sum(row.values["passed"] for row in rows)
        wrong = sum(row.values["outcome"] == "missed" and not row.values["passed"] for row in rows)
        return (
            f"Of {len(rows)} cases {right} are right, {passed - right} stop with the reason they should, "
            f"{len(rows) - passed - wrong} stop with another and say so, {wrong} are wrong."
        )
