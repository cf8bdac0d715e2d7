"""Closed forms, published values and hard cases that every solver has to solve, and FElupe as one more code."""

from __future__ import annotations

import importlib.util
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu

from ...lhm.base.errors import MissingDependencyError, SceneError, SoftdecaError
from ...lhm.base.mesh import Floats, Ints
from ...lhm.base.option import option
from ...reference import Parameters, Scene, apply_law, facial_scene, materials, problems, solve, terms
from ..harness.study import Column, Row, Study, Table, Task, Values, at_most
from .measures import largest_distance
from .person import parse_solvers, person

HEAD, FELUPE = "neo-Hookean head", "felupe"
HEAD_EXPRESSION, HEAD_LEVEL, HEAD_BOUND = "mouthSmileLeft*0.3", 1, 1e-8
Outcomes = Callable[[], Sequence[problems.Outcome]]


@dataclass(frozen=True)
class Verification(Study):
    """Closed forms, published values, another code on a head; with `fine` orders of convergence too."""

    name = "verification"
    heading = "Do the solvers give the answers that are known?"
    question = "Do the solvers give closed forms, published values and theory's orders of convergence?"
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
        # What takes longest is first, so that no process is left with it while the others have ended.
        return [Task(HEAD, FELUPE), *(Task(name, "fenicsx") for name in (_list_fine() if self.fine else ())), *tasks]

    def measure(self, task: Task) -> Values:
        """Measure the outcomes of a problem, or of a series of meshes."""
        if task.case == HEAD:
            subject = person(level=HEAD_LEVEL)
            scene = facial_scene(
                subject.head, Parameters(), subject.shape(HEAD_EXPRESSION), bones="prescribed", without=("skin",)
            )
            return {"outcomes": [asdict(compare_felupe(apply_law(scene, "neo-Hookean")))]}
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


def compare_felupe(scene: Scene) -> problems.Outcome:
    """Compare the largest displacement [mm] by FElupe, and the largest distance to FEniCSx' answer over it."""
    begin = time.perf_counter()
    positions, iterations = solve_by_felupe(scene)
    seconds = time.perf_counter() - begin
    truth = solve(scene, solver="fenicsx", tolerance=1e-10)
    value, reference = largest_distance(positions, scene.vertices), largest_distance(truth.positions, scene.vertices)
    error = largest_distance(positions, truth.positions) / reference
    return problems.Outcome(
        HEAD, "an independent code: FElupe (PyPI); reference: FEniCSx", FELUPE, value, reference, error, HEAD_BOUND,
        truth.converged and error <= HEAD_BOUND, truth.reason.name, seconds, iterations,
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
    heading = "Do the solvers survive hard cases?"
    question = "Are hard-pushed solvers right, do they say why they stop, or are they silently wrong?"
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
            for case in (*problems.HARD, *problems.added_hard_cases())
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
        """Tell how many are right, and how many stopped for a reason that is right to name."""
        kinds = Counter(map(_judge, rows))
        right, refused, wrong = (kinds[kind] for kind in KINDS)
        return f"Of {len(rows)} cases {right} are right, {refused} stop with the reason they should, {wrong} are wrong."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Count right, refused and wrong runs by solver and element; and of each case, seeds and laws together."""
        ways = list(dict.fromkeys(row.method for row in rows))
        outcomes = Counter((row.method, _judge(row)) for row in rows)
        counts = [[way, *(outcomes[way, kind] for kind in KINDS)] for way in ways]
        by_kind: dict[str, dict[str, list[Row]]] = {}
        for row in rows:
            kind = row.case.split(", seed ")[0] + (" (H1)" if ", seed " in row.case else "")
            by_kind.setdefault(kind, {}).setdefault(row.method, []).append(row)
        lines = [
            [kind, *(_describe_runs(by_method.get(way, [])) for way in ways)] for kind, by_method in by_kind.items()
        ]
        note = "Of the runs of a case, seeds among them: how many are right, refused with a reason, wrong; iterations."
        return [
            Table("By solver and element", ["solver and element", *KINDS], counts),
            Table("Right, refused, wrong", ["case", *ways], lines, note),
        ]


KINDS = ("right", "refused", "WRONG")


def _judge(row: Row) -> str:
    return KINDS[0] if row.values["outcome"] == "passed" else KINDS[1] if row.values["passed"] else KINDS[2]


def _describe_runs(rows: Sequence[Row]) -> str | None:
    """As "20 right, 8 to 31 iterations"."""
    if not rows:
        return None
    kinds = Counter(map(_judge, rows))
    counts = sorted(int(row.values["iterations"]) for row in rows)
    span = f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"
    outcome = ", ".join(kind if len(rows) == 1 else f"{count} {kind}" for kind, count in kinds.items())
    return f"{outcome}; {span}"


TOLERANCE = 1e-10
"""The residual's norm over that of the forces at held vertices, as FElupe counts it."""
MOST, STEPS = 30, 4
"""Iterations of a step of the load, and such steps."""


def solve_by_felupe(scene: Scene) -> tuple[Floats, int]:
    """Find positions [mm], shape (n, 3), by FElupe's elements, law and Newton's method from rest, and its iterations.

    Raises MissingDependencyError without FElupe, SceneError for a term that is not modelled here, and SoftdecaError
    where it does not converge.
    """
    if importlib.util.find_spec("felupe") is None:
        raise MissingDependencyError("FElupe is not installed (softdeca[bench])")
    import felupe

    for term in scene.terms:
        if not isinstance(term, (terms.Hyperelastic, terms.Target, terms.Fixed)):
            raise SceneError(f"FElupe: {type(term).__name__} is not modelled here")
    bodies: list[tuple[materials.NeoHookean, Ints]] = []
    for solid in scene.of(terms.Hyperelastic):
        if not isinstance(solid.material, materials.NeoHookean) or np.any(solid.growth != 1.0):
            raise SceneError(f"FElupe: {solid.material.name} with growth {solid.growth} is not modelled here")
        bodies.append((solid.material, scene.tets[scene.tets_of(solid)]))

    def solve_linear(matrix: Any, right: Floats) -> Floats:
        # Symmetric: a quarter of the fill of the order that SciPy takes by itself.
        return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(right.ravel())

    field = _make_field(felupe, scene.vertices, scene.tets)
    # A body of its own for each term: FElupe links their fields, which have the same vertices.
    items: list[Any] = [
        felupe.SolidBody(felupe.NeoHookeCompressible(law.mu, law.lmbda), _make_field(felupe, scene.vertices, tets))
        for law, tets in bodies
    ]
    items += [_Springs(field, each) for each in scene.of(terms.Target)]
    held, places = scene.dirichlet()
    loose = np.setdiff1d(np.arange(len(scene.vertices)), scene.tets)
    fixed = held.copy()
    fixed[loose] = True
    dof0 = np.flatnonzero(fixed.ravel())
    dof1 = np.flatnonzero(~fixed.ravel())
    target = np.where(held, places - scene.vertices, 0.0).ravel()[dof0]
    iterations = 0
    for step in range(1, STEPS + 1):
        # FElupe takes whole steps of Newton's: in one go they turn tets inside out, where the law is infinite.
        for each in items[len(bodies) :]:
            each.share = step / STEPS
        answer = felupe.newtonraphson(
            items=items, x0=field, dof0=dof0, dof1=dof1, ext0=target * step / STEPS, tol=TOLERANCE, maxiter=MOST,
            solver=solve_linear, verbose=0,
        )  # fmt: skip
        if not answer.success:
            raise SoftdecaError(f"FElupe: step {step} of {STEPS} not converged after {MOST} iterations")
        field, iterations = answer.x, iterations + int(answer.iterations)
    return scene.vertices + field[0].values, iterations


def _make_field(felupe: Any, vertices: Floats, tets: Ints) -> Any:
    return felupe.FieldContainer([felupe.Field(felupe.RegionTetra(felupe.Mesh(vertices, tets, "tetra")), dim=3)])


class _Springs:
    """A Target as an item of FElupe: stiffness (target - x) at each of its vertices, `share` of the way there."""

    def __init__(self, field: Any, target: terms.Target):
        self.field = field
        self.results = SimpleNamespace(update_statevars=lambda: None)
        self.assemble = SimpleNamespace(vector=self._vector, matrix=self._matrix, multiplier=None)
        n = field[0].values.size
        k = np.zeros((n // 3, 3))
        np.add.at(k, target.vertices, np.broadcast_to(np.reshape(target.stiffness, (-1, 1)), target.positions.shape))
        sought = np.zeros((n // 3, 3))
        sought[target.vertices] = target.positions
        self.share = 1.0
        self._k, self._away = k.ravel(), (sought - field.region.mesh.points).ravel()

    def _vector(self, field: Any = None, **_: Any) -> csr_matrix:
        u = (self.field if field is None else field)[0].values.ravel()
        return csr_matrix((self._k * (u - self.share * self._away)).reshape(-1, 1))

    def _matrix(self, field: Any = None, **_: Any) -> csr_matrix:
        return diags(self._k).tocsr()
