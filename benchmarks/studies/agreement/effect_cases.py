"""The effects by name, and one of them simulated on a head."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.mesh import Floats
from ....lhm.flesh import cheek_share, flesh_share, mean_on_triangles
from ....lhm.head import LayeredHead
from ....reference import Parameters, Scene, SettledFace, Solution, facial_scene, prepare, settle
from ..measures import distances

SMILE = {"mouthSmileLeft": 0.6, "mouthSmileRight": 0.6, "jawOpen": 0.2}
BROAD_SMILE = {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0, "jawOpen": 0.2}
SNEER = SMILE | {"noseSneerLeft": 0.6, "noseSneerRight": 0.6}
LEAN = 1.6
"""Soft tissue's stiffness [kPa] of fat and SMAS (Barbarino et al. 2011), where weight is what is looked at."""


def _plain(head: LayeredHead) -> Parameters:
    return Parameters()


@dataclass(frozen=True)
class Effect:
    """Parameters `with_it`, and `without` it, of one head; an expression as ARKit weights; what the paper shows."""

    name: str
    shown: str
    expression: Mapping[str, float]
    with_it: Callable[[LayeredHead], Parameters]
    without: Callable[[LayeredHead], Parameters] = _plain


def _grown(share: float) -> Callable[[LayeredHead], Parameters]:
    return lambda head: Parameters(soft_volume=1.0 + share * mean_on_triangles(head, flesh_share(head)))


def _zombie(head: LayeredHead) -> Parameters:
    growth = 1.0 + 0.4 * mean_on_triangles(head, flesh_share(head))
    return Parameters(skin_growth=growth, skin_stiffness=100.0, skin_bending=20.0)


def _loose_cheeks(head: LayeredHead) -> Parameters:
    return Parameters(target_stiffness=10.0 ** (1.0 - mean_on_triangles(head, cheek_share(head))))


def _stiff_cheeks(head: LayeredHead) -> Parameters:
    share = mean_on_triangles(head, cheek_share(head))
    return replace(_loose_cheeks(head), skin_stiffness=20.0 * 15.0**share, skin_bending=3.0 * share)


EFFECTS = (
    Effect(
        "bells-palsy",
        "Figure 1: one half of the face does not follow the expression",
        BROAD_SMILE,
        lambda head: Parameters(paralysis_left=1.0),
    ),
    Effect("weight-20", "Figure 7 g: soft tissue's volume raised by 20 %", SMILE, _grown(0.2)),
    Effect("weight-40", "Figure 7 h: soft tissue's volume raised by 40 %", SMILE, _grown(0.4)),
    Effect(
        "jaw",
        "Figure 7 d: the jaw is lengthened vertically, volume kept",
        SMILE,
        lambda head: Parameters(mandible_scale_y=1.15),
    ),
    Effect("zombie", "Figure 7 f: the area of the skin grows", SMILE, _zombie),
    Effect(
        "gravity-3",
        "Figure 7 c: gravity is increased",
        SMILE,
        lambda head: Parameters(gravity=3.0, soft_stiffness=LEAN),
        lambda head: Parameters(soft_stiffness=LEAN),
    ),
    Effect(
        "lying",
        "3.3.3: another direction of gravity, here of one who lies on the back",
        SMILE,
        lambda head: Parameters(gravity_y=0.0, gravity_z=-1.0, soft_stiffness=LEAN),
        lambda head: Parameters(soft_stiffness=LEAN),
    ),
    Effect(
        "wrinkles",
        "Figure 7 b: the skin's strain weighs more in the cheeks, which wrinkle",
        SNEER,
        _stiff_cheeks,
        _loose_cheeks,
    ),
)
"""Weights of expressions and sizes of effects that the paper does not give are this project's.

A broad smile folds the skin beside the mouth's corners, and under 3 g with two minima, 1 mm apart, which no skin, a
skin of 5 mN/mm or a bending of 20 mN mm makes one: hence the smile of 0.6. Grown skin has one minimum only where it
bends, hence the zombie's bending; cheeks whose targets are as stiff as everywhere cannot wrinkle, hence the loose ones.
"""


def named_effects(names: str) -> tuple[Effect, ...]:
    """The effects of a list of names between commas; all for an empty one. InputError for an unknown name."""
    known = {effect.name: effect for effect in EFFECTS}
    asked = [name.strip() for name in names.split(",") if name.strip()] or list(known)
    for name in asked:
        if name not in known:
            raise InputError(f"unknown effect {name!r}; there are {', '.join(known)}")
    return tuple(known[name] for name in dict.fromkeys(asked))


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
