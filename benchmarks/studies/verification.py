"""Every verification problem through every solver that models it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from ...reference import Parameters, Scene, apply_law, facial_scene, problems, solve
from .. import felupe_code
from ..harness.gates import at_most
from ..harness.runner import Row
from ..harness.study import Column, Study, Task, Values
from ..traces import farthest
from .asked import solvers_asked
from .person import person

HEAD, FELUPE = "neo-Hookean head", "felupe"
HEAD_EXPRESSION, HEAD_LEVEL, HEAD_BOUND = "mouthSmileLeft*0.3", 1, 1e-8
Outcomes = Callable[[], Sequence[problems.Outcome]]


@dataclass(frozen=True)
class Verification(Study):
    """Closed forms, published values, another code on a head; with `fine` orders of convergence and locking too."""

    name = "verification"
    heading = "Do the solvers give the answers that are known?"
    question = "Do the solvers give closed forms, published values and theory's orders of convergence?"
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

    solvers: tuple[str, ...] = field(default=(), metadata={"help": "only these; repeat for several  [all]"})
    fine: bool = field(default=False, metadata={"help": "also finer meshes, orders and locking by FEniCSx: 15 minutes"})

    def tasks(self) -> Sequence[Task]:
        """Each problem by each solver."""
        solvers = solvers_asked(self.solvers)
        posed = (*_posed(), *problems.FINE) if self.fine else _posed()
        found = [Task(problem.name, solver) for problem in posed for solver in solvers if solver in problem.solvers]
        if "fenicsx" not in solvers:
            return found
        # What takes longest is first, so that no process is left with it while the others have ended.
        return [Task(HEAD, FELUPE), *(Task(name, "fenicsx") for name in (_fine() if self.fine else ())), *found]

    def measure(self, task: Task) -> Values:
        """The outcomes of a problem, or of a series of meshes or materials."""
        if task.case == HEAD:
            of = person(level=HEAD_LEVEL)
            scene = facial_scene(
                of.head, Parameters(), of.shape(HEAD_EXPRESSION), bones="prescribed", without=("skin",)
            )
            return {"outcomes": [asdict(felupe_beside_fenicsx(apply_law(scene, "neo-Hookean")))]}
        fine = _fine().get(task.case)
        if fine is not None:
            return {"outcomes": [asdict(outcome) for outcome in fine()]}
        problem = next(p for p in (*_posed(), *problems.FINE) if p.name == task.case)
        return {"outcomes": [asdict(problems.run(problem, task.method))]}

    @staticmethod
    def lines(values: Values) -> Sequence[Values]:
        """An outcome each."""
        outcomes: Sequence[Values] = values["outcomes"]
        return outcomes

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """None outside its bound."""
        outside = sum(not outcome["passed"] for row in rows for outcome in self.lines(row.values))
        return [at_most("values outside their bound", outside, 0)]

    def words(self, rows: Sequence[Row]) -> str:
        """How many there are."""
        outcomes = [outcome for row in rows for outcome in self.lines(row.values)]
        within = sum(outcome["passed"] for outcome in outcomes)
        solvers = sorted({outcome["solver"] for outcome in outcomes})
        return f"{within} of {len(outcomes)} values by {', '.join(solvers)} are within their bounds."


def felupe_beside_fenicsx(scene: Scene) -> problems.Outcome:
    """The largest displacement [mm] by FElupe, and the largest distance to FEniCSx' answer over it."""
    begin = time.perf_counter()
    positions, iterations = felupe_code.solved(scene)
    seconds = time.perf_counter() - begin
    truth = solve(scene, solver="fenicsx", tolerance=1e-10)
    value, reference = farthest(positions, scene.vertices), farthest(truth.positions, scene.vertices)
    error = farthest(positions, truth.positions) / reference
    return problems.Outcome(
        HEAD, "an independent code: FElupe (PyPI); reference: FEniCSx", FELUPE, value, reference, error, HEAD_BOUND,
        truth.converged and error <= HEAD_BOUND, truth.reason.name, seconds, iterations,
    )  # fmt: skip


def _posed() -> Sequence[problems.Problem]:
    return (*problems.ALL, *problems.added_problems())


def _fine() -> Mapping[str, Outcomes]:
    orders = {f"orders of {e}": lambda e=e: list(problems.manufactured.study(e)) for e in problems.manufactured.ORDERS}
    locking = {f"locking, nu={nu:g}": lambda nu=nu: problems.cook.locking_outcomes(nu) for nu in problems.cook.POISSON}
    return orders | locking
