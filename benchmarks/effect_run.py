"""One effect on one head: the scenes with and without it, and how well they are solved."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ..lhm.base.mesh import Floats
from ..lhm.head import LayeredHead
from ..reference import Scene, SettledFace, Solution, facial_scene, prepare, settle
from .differences import distances
from .effect_cases import Effect

TOLERANCE, TIGHT = 1e-6, 1e-10
"""Gradient norm relative to its start, of what is measured and of what it is compared with."""
ROUNDING = 1e-12
"""A rise of the energy by at most this share of it is rounding."""


@dataclass(frozen=True, eq=False)
class EffectResult:
    """PD's answer to an effect: figures, the settled face, and the expression's scene and solution.

    neutral, without and with_it are skins [mm], shape (skin vertices, 3).
    """

    record: dict
    at_rest: SettledFace
    scene: Scene
    solution: Solution
    neutral: Floats
    without: Floats
    with_it: Floats


@dataclass(frozen=True, eq=False)
class Solved:
    """A scene with its targets [mm], shape (skin vertices, 3), where its solve starts, and the answer.

    `seconds` has preparation and solve.
    """

    scene: Scene
    targets: Floats
    start: Floats
    solution: Solution
    seconds: float


def solved(scene: Scene, targets: Floats, start: Floats, *, tolerance: float = TOLERANCE) -> Solved:
    """Solve a scene cold."""
    begin = time.perf_counter()
    solution = prepare(scene).solve(start=start, tolerance=tolerance)
    return Solved(scene, targets, start, solution, time.perf_counter() - begin)


def with_effect(head: LayeredHead, effect: Effect, expression: Floats) -> tuple[SettledFace, Solved]:
    """The neutral face at rest under an effect, and the expression that starts from it.

    expression [mm], shape (skin vertices, 3), is that of the head without the effect.
    """
    at_rest = settle(head, effect.with_it(head))
    return at_rest, solved(at_rest.scene(expression), at_rest.targets(expression), at_rest.positions)


def run_effect(head: LayeredHead, effect: Effect, expression: Floats) -> EffectResult:
    """Solve an effect's scenes by PD and compare the answer with a tight run from another start.

    expression [mm], shape (skin vertices, 3), is that of the head without the effect.
    """
    at_rest, ended = with_effect(head, effect, expression)
    plain_scene = facial_scene(head, effect.without(head), expression, bones="rigid")
    plain = solved(plain_scene, expression, plain_scene.vertices)
    answer = ended.solution.positions
    other = solved(ended.scene, ended.targets, displaced(head, ended.targets), tolerance=TIGHT).solution
    near = solved(ended.scene, ended.targets, answer, tolerance=TIGHT / TOLERANCE).solution
    skins = [head.skin_after(plain.targets, plain.solution.positions[: len(head.bone)])]
    skins.append(at_rest.skin_after(expression, answer))
    change = distances(*skins)
    record = {
        "name": effect.name,
        "shown": effect.shown,
        "expression": dict(effect.expression),
        "runs": {
            name: _figures(head, ended.scene, solution)
            for name, solution in (("neutral", at_rest.solution), ("with", ended.solution), ("without", plain.solution))
            if solution is not None
        },
        "to_own_limit_mm": float(distances(answer, near.positions).max()),
        "to_other_start_mm": float(distances(answer, other.positions).max()),
        "other_start": {"iterations": other.iterations, "converged": other.converged, "energy": other.energy},
        "change_mm": {"mean": float(change.mean()), "max": float(change.max())},
        "neutral_change_mm": float(distances(at_rest.skin, head.skin.vertices).max()),
    }
    return EffectResult(record, at_rest, ended.scene, ended.solution, at_rest.skin, *skins)


def displaced(head: LayeredHead, targets: Floats) -> Floats:
    """Another start [mm], shape (3 n, 3): every wrap moved by the skin wrap's way to its targets, bone or not."""
    return head.vertices + np.tile(head.wrap_targets(targets) - head.skin_wrap.vertices, (3, 1))


def _figures(head: LayeredHead, scene: Scene, solution: Solution) -> dict:
    history = solution.history
    size = np.maximum(np.abs(history.energy[:-1]), np.finfo(float).tiny)
    rise = float(np.max(np.diff(history.energy) / size, initial=0.0))
    soft = slice(0, len(head.soft.tets))
    volumes = scene.volumes[soft]
    first = history.gradient_norm[0]
    return {
        "iterations": solution.iterations,
        "seconds": float(history.time[-1]),
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
