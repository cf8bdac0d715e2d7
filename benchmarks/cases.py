"""One expression of one head, by every solver: errors against run time and iterations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..reference import Parameters, Reason, Scene, Solution, neo_hookean_scene, prepare, settled, solve
from .differences import difference

TIGHT = 1e-10
"""Gradient norm relative to its start at which solvers that are compared stop."""
WARM = 1e-9
"""The same for those that start at PD's answer, where the gradient is smaller already."""
ROUGH = 1e-6
"""PD is stopped here to start scikit-fem, whose part is to check the answer and not to be fast."""
APART = 1e-4
"""Of the largest displacement: converged answers that are farther apart than this are two minima."""
PD_ENERGY, NEO_HOOKEAN = "PD", "neo-Hookean"
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
    """Solve one case with FEniCSx, scikit-fem and projective dynamics on PD's energy, and with the neo-Hookean law.

    A broad smile may fold the skin beside the mouth in more than one way. Where FEniCSx, which starts at rest, ends in
    another minimum than PD, it is started at PD's answer too: PD is right if FEniCSx stays there.
    """
    neutral = settled(head, case.parameters)
    scene, targets = neutral.scene(expression), neutral.targets(expression)
    runs: dict[str, tuple[Solution, dict]] = {}

    def add(key: str, label: str, law: str, target: Scene, how: _How) -> Floats:
        tell(f"{case.name}: {label}{'' if law == PD_ENERGY else ', ' + law}")
        runs[key] = _run(label, law, target, how)
        return runs[key][0].positions

    fenicsx, accelerated, checked = "FEniCSx Newton", "PD, accelerated", "scikit-fem Newton"
    truth = add("fenicsx", fenicsx, PD_ENERGY, scene, _How("fenicsx"))
    answer = add("pd", accelerated, PD_ENERGY, scene, _How("projective", truth=truth))
    beside = difference(truth, answer, scene.vertices)
    if beside.relative > APART:
        truth = add("fenicsx at pd", fenicsx, PD_ENERGY, scene, _How("fenicsx", tolerance=WARM, start=answer))
        answer = add("pd", accelerated, PD_ENERGY, scene, _How("projective", truth=truth))
    plain = _How("projective", method="plain", truth=truth, stop_at=PLAIN_STOP, max_iterations=PLAIN_LIMIT)
    add("plain", "PD, plain", PD_ENERGY, scene, plain)
    rough = solve(scene, solver="projective", tolerance=ROUGH).positions
    add("skfem", checked, PD_ENERGY, scene, _How("skfem", tolerance=TIGHT / ROUGH, start=rough, truth=truth))
    neo = neo_hookean_scene(scene)
    # The neo-Hookean energy is infinite where a tet is inverted: then PD's answer is no start for it.
    start = answer if runs["pd"][0].volume_ratio.min() > 0 else None
    add("neo", fenicsx, NEO_HOOKEAN, neo, _How("fenicsx", tolerance=WARM, start=start))
    add("neo_skfem", checked, NEO_HOOKEAN, neo, _How("skfem", tolerance=WARM, start=start))

    rest = scene.vertices
    n = len(head.bone)
    answers = {key: solution.positions for key, (solution, _) in runs.items()}
    answers["fenicsx"] = truth
    skins = {key: head.skin_after(targets, x[:n]) for key, x in answers.items()}
    lips = head.regions["lips"]
    residual = np.linalg.norm(answers["pd"][:n] - head.wrap_targets(targets), axis=1)
    record = {
        "name": case.name,
        "parameters": asdict(case.parameters),
        "largest_displacement_mm": float(np.linalg.norm(truth - rest, axis=1).max()),
        "another_minimum_mm": beside.max if beside.relative > APART else None,
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


@dataclass(frozen=True, eq=False)
class _How:
    """A solver, its options, and where it starts and stops."""

    solver: str
    method: str | None = None
    tolerance: float = TIGHT
    start: Floats | None = None
    truth: Floats | None = None
    stop_at: float = -1.0
    max_iterations: int | None = None


def _run(label: str, law: str, scene: Scene, how: _How) -> tuple[Solution, dict]:
    errors: list[float] = []
    visited: list[Floats] = []

    def track(iteration: int, positions: Floats, energy: float, gradient_norm: float) -> bool:
        if how.truth is None:
            visited.append(np.array(positions))
            return False
        errors.append(_rms(positions, how.truth))
        return errors[-1] <= how.stop_at

    options = {} if how.method is None else {"method": how.method}
    solution = prepare(scene, solver=how.solver, **options).solve(
        tolerance=how.tolerance, start=how.start, max_iterations=how.max_iterations, on_iteration=track
    )
    if how.truth is None:
        errors = [_rms(x, solution.positions) for x in visited]
    # A solver stopped on purpose, near enough to the truth, has done what was asked.
    done = solution.converged or (solution.reason is Reason.INTERRUPTED and errors[-1] <= how.stop_at)
    history, times = solution.history, solution.times
    assert times is not None
    return solution, {
        "label": label,
        "solver": how.solver,
        "start": "rest" if how.start is None else "PD's answer",
        "energy_law": law,
        "compile_seconds": times.compilation,
        "prepare_seconds": times.preparation,
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
