"""One effect on one head: the scenes with and without it, and how well they are solved."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve

from ..lhm.head import FREE, LayeredHead
from ..lhm.mesh import Floats
from ..reference import Parameters, Scene, Solution, facial_scene, prepare, terms
from ..reference.bones import scaled_skull
from .differences import distances
from .effect_cases import Effect, fleshy

TOLERANCE, TIGHT = 1e-6, 1e-10
"""Gradient norm relative to its start, of what is measured and of what it is compared with."""
ROUNDING = 1e-12
"""A rise of the energy by at most this share of it is rounding."""


@dataclass(frozen=True, eq=False)
class EffectResult:
    """Figures for the results file, and skins [mm], shape (skin vertices, 3), for pictures."""

    record: dict
    neutral: Floats
    without: Floats
    with_it: Floats


def neutral_scene(head: LayeredHead, parameters: Parameters) -> Scene:
    """The neutral face left to come to rest under its parameters: what is fleshy is held by no target.

    The paper is silent about how targets, which hold the old surface, give way to a face that has grown. Here the
    neutral face settles where its flesh hangs on bone and on the face around alone, bones held at their scaled rest;
    that displacement is then added to every target.
    """
    scene = facial_scene(head, parameters, head.skin.vertices, bones="prescribed")
    kept = 1.0 - fleshy(head)
    return replace(
        scene,
        terms=tuple(
            replace(t, stiffness=t.stiffness * kept) if isinstance(t, terms.Target) else t for t in scene.terms
        ),
    )


def carried_by_bones(head: LayeredHead, parameters: Parameters) -> Floats:
    """The stacked wraps [mm], shape (3 n, 3), moved with the bones that p scales, smoothly in between.

    All three wraps move by the skull wrap's displacement, harmonic along it where it is no bone: a start without
    inverted tets, from which the energy can only fall.
    """
    moved = scaled_skull(head, parameters) - head.skull_wrap.vertices
    free = head.bone == FREE
    if moved.any() and free.any():
        a, b = head.skull_wrap.triangles.ravel(), np.roll(head.skull_wrap.triangles, -1, axis=1).ravel()
        n = len(free)
        near = csr_matrix((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), shape=(n, n))
        laplacian = (diags(np.asarray(near.sum(axis=1)).ravel()) - near).tocsr()
        moved[free] = spsolve(laplacian[free][:, free].tocsc(), -laplacian[free][:, ~free] @ moved[~free])
    return head.vertices + np.tile(moved, (3, 1))


@dataclass(frozen=True, eq=False)
class Solved:
    """A scene with its targets [mm], shape (skin vertices, 3), where its solve starts, and the answer."""

    scene: Scene
    targets: Floats
    start: Floats
    solution: Solution
    seconds: float


def solved(scene: Scene, targets: Floats, start: Floats, *, solver: str = "projective", tolerance=TOLERANCE) -> Solved:
    """Solve a scene cold; `seconds` has preparation and solve."""
    begin = time.perf_counter()
    solution = prepare(scene, solver=solver).solve(start=start, tolerance=tolerance)
    return Solved(scene, targets, start, solution, time.perf_counter() - begin)


def with_effect(head: LayeredHead, effect: Effect, expression: Floats) -> tuple[Solved | None, Solved]:
    """The neutral face at rest under an effect, None if it stays as it is, and the expression that starts from it.

    expression [mm], shape (skin vertices, 3), is that of the head without the effect.
    """
    parameters = effect.with_it(head)
    if not effect.settles:
        scene = facial_scene(head, parameters, expression, bones="rigid")
        return None, solved(scene, expression, scene.vertices)
    at_rest = solved(neutral_scene(head, parameters), head.skin.vertices, carried_by_bones(head, parameters))
    targets = expression + _skin_displacement(head, at_rest.solution.positions)
    scene = facial_scene(head, parameters, targets, bones="rigid")
    return at_rest, solved(scene, targets, at_rest.solution.positions)


def _skin_displacement(head: LayeredHead, positions: Floats) -> Floats:
    return head.skin_from_wrap @ (positions[: len(head.bone)] - head.skin_wrap.vertices)


def run_effect(head: LayeredHead, effect: Effect, expression: Floats, *, reference: str | None = None) -> EffectResult:
    """Solve an effect's scenes and compare the answer with a tight run from another start, and with `reference`.

    expression [mm], shape (skin vertices, 3), is that of the head without the effect; reference, a solver's name.
    """
    n = len(head.bone)
    at_rest, ended = with_effect(head, effect, expression)
    plain_scene = facial_scene(head, effect.without(head), expression, bones="rigid")
    plain = solved(plain_scene, expression, plain_scene.vertices)
    answer = ended.solution.positions
    other = solved(ended.scene, ended.targets, displaced(head, ended.targets), tolerance=TIGHT).solution
    near = solved(ended.scene, ended.targets, answer, tolerance=TIGHT / TOLERANCE).solution
    compared = None if reference is None else _compared(ended, reference)
    skins = [head.skin_after(run.targets, run.solution.positions[:n]) for run in (plain, ended)]
    settled_skin = head.skin.vertices + (
        0.0 if at_rest is None else _skin_displacement(head, at_rest.solution.positions)
    )
    change = distances(*skins)
    record = {
        "name": effect.name,
        "shown": effect.shown,
        "expression": dict(effect.expression),
        "runs": {
            name: _figures(head, run)
            for name, run in (("neutral", at_rest), ("with", ended), ("without", plain))
            if run is not None
        },
        "to_own_limit_mm": float(distances(answer, near.positions).max()),
        "to_other_start_mm": float(distances(answer, other.positions).max()),
        "other_start": {"iterations": other.iterations, "converged": other.converged, "energy": other.energy},
        "reference": compared,
        "change_mm": {"mean": float(change.mean()), "max": float(change.max())},
        "neutral_change_mm": float(distances(settled_skin, head.skin.vertices).max()),
    }
    return EffectResult(record, settled_skin, *skins)


def displaced(head: LayeredHead, targets: Floats) -> Floats:
    """Another start [mm], shape (3 n, 3): every wrap moved by the skin wrap's way to its targets, bone or not."""
    return head.vertices + np.tile(head.wrap_targets(targets) - head.skin_wrap.vertices, (3, 1))


def _figures(head: LayeredHead, run: Solved) -> dict:
    solution, history = run.solution, run.solution.history
    size = np.maximum(np.abs(history.energy[:-1]), np.finfo(float).tiny)
    rise = float(np.max(np.diff(history.energy) / size, initial=0.0))
    soft = slice(0, len(head.soft.tets))
    volumes = run.scene.volumes[soft]
    first = history.gradient_norm[0]
    return {
        "iterations": solution.iterations,
        "seconds": run.seconds,
        "solve_seconds": float(history.time[-1]),
        "converged": solution.converged,
        "reason": str(solution.reason),
        "gradient_ratio": float(history.gradient_norm[-1] / first) if first > 0 else 0.0,
        "largest_rise": rise,
        "monotone": rise <= ROUNDING,
        "energy": solution.energy,
        "inverted_tets": int(np.count_nonzero(solution.volume_ratio <= 0)),
        "smallest_volume_ratio": float(solution.volume_ratio.min()),
        "soft_volume_percent": float(100.0 * (solution.volume_ratio[soft] @ volumes / volumes.sum() - 1.0)),
    }


def _compared(ended: Solved, reference: str) -> dict:
    """The distance to another solver's answer from the same start, and what that took."""
    against = solved(ended.scene, ended.targets, ended.start, solver=reference, tolerance=TIGHT)
    return {
        "solver": reference,
        "mm": float(distances(ended.solution.positions, against.solution.positions).max()),
        "iterations": against.solution.iterations,
        "seconds": against.seconds,
        "converged": against.solution.converged,
        "energy": against.solution.energy,
    }
