"""One expression of one head, by every solver: errors against run time and iterations."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..reference import Parameters, Reason, Scene, Solution, facial_scene, neo_hookean_scene, prepare
from .differences import difference

TIGHT = 1e-10
"""Gradient norm relative to its start at which solvers that are compared stop."""
PLAIN_STOP = 0.005
"""Plain projective dynamics stops here [mm RMS], below the 0.01 mm that iterations are counted to."""
PLAIN_LIMIT = 4000


@dataclass(frozen=True)
class Case:
    """An expression as weights (52,), its parameters, and what the report calls it."""

    name: str
    weights: Floats
    parameters: Parameters


@dataclass(frozen=True, eq=False)
class CaseResult:
    """What `run_case` found: figures for the results file, and skins [mm] for pictures and the surrogate."""

    record: dict
    expression: Floats
    pd_skin: Floats
    fem_skin: Floats
    neo_hookean_skin: Floats
    positions: Floats


def run_case(head: LayeredHead, case: Case, expression: Floats, tell: Callable[[str], None]) -> CaseResult:
    """Solve one case with FEniCSx, scikit-fem and projective dynamics on PD's energy, and with the neo-Hookean law."""
    scene = facial_scene(head, case.parameters, expression)
    runs: dict[str, tuple[Solution, dict]] = {}

    def add(key: str, label: str, solver: str, law: str, target: Scene, options: dict, **how):
        tell(f"{case.name}: {label}{'' if law == 'pd' else ', neo-Hookean'}")
        runs[key] = _run(label, solver, law, target, options, **how)

    add("fenicsx", "FEniCSx Newton", "fenicsx", "pd", scene, {}, tolerance=TIGHT)
    truth = runs["fenicsx"][0].positions
    add("pd", "PD, accelerated", "projective", "pd", scene, {}, tolerance=TIGHT, truth=truth)
    add(
        "plain", "PD, plain", "projective", "pd", scene, {"method": "plain"},
        tolerance=TIGHT, truth=truth, stop_at=PLAIN_STOP, max_iterations=PLAIN_LIMIT,
    )  # fmt: skip
    add("skfem", "scikit-fem Newton", "skfem", "pd", scene, {}, tolerance=TIGHT, truth=truth)
    neo = neo_hookean_scene(scene)
    add("neo", "FEniCSx Newton", "fenicsx", "neo-Hookean", neo, {}, tolerance=TIGHT)
    add("neo_skfem", "scikit-fem Newton", "skfem", "neo-Hookean", neo, {}, tolerance=TIGHT)

    rest = scene.vertices
    n = len(head.bone)
    answers = {key: solution.positions for key, (solution, _) in runs.items()}
    skins = {key: head.skin_after(expression, x[:n]) for key, x in answers.items()}
    lips = head.regions["lips"]
    residual = np.linalg.norm(answers["pd"][:n] - head.wrap_targets(expression), axis=1)
    record = {
        "name": case.name,
        "parameters": asdict(case.parameters),
        "largest_displacement_mm": float(np.linalg.norm(truth - rest, axis=1).max()),
        "runs": [row for _, row in runs.values()],
        "comparisons": {
            "PD to FEniCSx, same energy": asdict(difference(answers["pd"], truth, rest)),
            "scikit-fem to FEniCSx, PD's energy": asdict(difference(answers["skfem"], truth, rest)),
            "scikit-fem to FEniCSx, neo-Hookean": asdict(difference(answers["neo_skfem"], answers["neo"], rest)),
            "PD to neo-Hookean": asdict(difference(answers["pd"], answers["neo"], rest)),
        },
        "skin": {
            "PD to neo-Hookean": asdict(difference(skins["pd"], skins["neo"], head.skin.vertices)),
            "blendshapes to PD": asdict(difference(expression, skins["pd"], head.skin.vertices)),
            "blendshapes to FEniCSx neo-Hookean": asdict(difference(expression, skins["neo"], head.skin.vertices)),
        },
        "target_residual_mm": _spread(residual),
        "target_residual_lips_mm": _spread(residual[lips]),
        "smallest_volume_ratio": float(runs["pd"][0].volume_ratio.min()),
        "iterations_to_001_mm": {key: first_below(runs[key][1]["error_mm"], 0.01) for key in ("pd", "plain")},
        "points": [],
    }
    return CaseResult(record, expression, skins["pd"], skins["fenicsx"], skins["neo"], answers["pd"])


def first_below(errors: list[float] | None, bound: float) -> int | None:
    """The first iteration whose error is at most `bound`, None if there is none."""
    return next((i for i, e in enumerate(errors or []) if e <= bound), None)


def _run(label, solver, law, scene, options, *, tolerance, truth=None, stop_at=-1.0, max_iterations=None):
    errors: list[float] = []
    visited: list[Floats] = []

    def track(iteration: int, positions: Floats, energy: float, gradient_norm: float) -> bool:
        if truth is None:
            visited.append(np.array(positions))
            return False
        errors.append(_rms(positions, truth))
        return errors[-1] <= stop_at

    begin = time.perf_counter()
    prepared = prepare(scene, solver=solver, **options)
    ready = time.perf_counter()
    solution = prepared.solve(tolerance=tolerance, max_iterations=max_iterations, on_iteration=track)
    if truth is None:
        errors = [_rms(x, solution.positions) for x in visited]
    # A solver stopped on purpose, near enough to the truth, has done what was asked.
    done = solution.converged or (solution.reason is Reason.INTERRUPTED and errors[-1] <= stop_at)
    history = solution.history
    return solution, {
        "label": label,
        "solver": solver,
        "energy_law": law,
        "prepare_seconds": ready - begin,
        "seconds": float(history.time[-1]),
        "iterations": solution.iterations,
        "done": bool(done),
        "reason": str(solution.reason),
        "energy": solution.energy,
        "detail": dict(solution.detail),
        "history": {
            "time": history.time.tolist(),
            "energy": history.energy.tolist(),
            "gradient_norm": history.gradient_norm.tolist(),
        },
        "error_mm": errors,
    }


def _rms(a: Floats, b: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))


def _spread(values: Floats) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "max": float(values.max()),
    }
