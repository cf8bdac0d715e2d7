"""Derivatives of a face by the parameters p, as difference quotients of scenes: two gradients each, but no solve."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats
from ..projective import Tangent
from ..scene import Scene
from .derivatives import TIGHT_ACCURACY, carry_to_skin, differentiate, rest_among_targets
from .face import Face
from .parameters import Parameters
from .settle import neutral_scene

STEP = 1e-4
"""Of the difference quotients, over a parameter's range."""


def skin_by_parameters(face: Face, along: Mapping[str, float | Floats]) -> dict[str, Floats]:
    """Differentiate the simulated neutral skin [mm], shape (skin vertices, 3), by parameters, as it settles anew.

    along: see `vertices_by_parameters`, local directions one per triangle of the wraps.
    """
    head, settled, parameters = face.head, face.settled(), face.on_wraps
    skin = settled.skin

    def settling_at(parameters: Parameters, targets: Floats) -> Scene:
        return neutral_scene(head, parameters, **face.choices)

    def scene_at(parameters: Parameters, targets: Floats) -> Scene:
        shifted = replace(settled, displacement=targets - head.skin.vertices)
        changed = Face(head, parameters=parameters, per="wraps", choices=face.choices)
        return changed.settled_as(shifted).neutral_scene()

    rested = rest_among_targets(settling_at(parameters, skin), settled.positions, TIGHT_ACCURACY)
    settling = differentiate(rested, accuracy=TIGHT_ACCURACY, like=face.derivatives.analysis)
    moves = vertices_by_parameters(settling.tangent, settling_at, parameters, skin, along)
    drift = {name: head.skin_from_wrap @ move[: len(head.bone)] for name, move in moves.items()}
    motions = vertices_by_parameters(face.derivatives.tangent, scene_at, parameters, skin, along, drift=drift)
    skins = carry_to_skin(head, np.stack(list(motions.values())), np.stack(list(drift.values())))
    return dict(zip(motions, skins, strict=True))


def vertices_by_parameters(
    tangent: Tangent,
    scene_at: Callable[[Parameters, Floats], Scene],
    parameters: Parameters,
    targets: Floats,
    along: Mapping[str, float | Floats],
    *,
    drift: Mapping[str, Floats] | None = None,
) -> dict[str, Floats]:
    """Differentiate a scene's vertices [mm], shape (n, 3), by parameters, by name.

    scene_at gives the scene of parameters and targets [mm], shape (skin vertices, 3); `along` names what is varied, by
    1.0 or, of a parameter that is local, by a direction of its shape; `drift` [mm per unit], of the targets' shape, is
    how targets move along, such as those that follow a neutral face that settles first.
    At an end of a parameter's range the quotient is one-sided, of second order. Raises InputError for an unknown
    parameter, and for a direction along which it cannot vary within its range.
    """

    def change(name: str, direction: float | Floats) -> Iterator[tuple[Scene, float]]:
        moving = None if drift is None else drift.get(name)
        for t, weight, changed in _quotient(parameters, name, direction):
            yield scene_at(changed, targets if moving is None else targets + t * moving), weight

    changes = (change(name, direction) for name, direction in along.items())
    return dict(zip(along, tangent.vertices_by_scenes(changes), strict=True))


def _quotient(parameters: Parameters, name: str, direction: float | Floats) -> list[tuple[float, float, Parameters]]:
    """Return steps t, weights, and parameters changed by t along a direction: central, or one-sided inwards."""
    info = Parameters.info(name)
    size = float(np.max(np.abs(direction)))
    if not (np.isfinite(size) and size > 0.0):
        raise InputError(f"parameter {name}: a direction to vary it along must be finite and not zero")
    h = STEP * (info.high - info.low) / size
    value = getattr(parameters, name)
    central = (h, 0.5 / h), (-h, -0.5 / h)
    # f'(0) = (-3 f(0) + 4 f(t) - f(2 t)) / (2 t), of second order.
    one_sided = (((0.0, -1.5 / t), (t, 2.0 / t), (2.0 * t, -0.5 / t)) for t in (h, -h))
    for stencil in (central, *one_sided):
        try:
            return [(t, weight, replace(parameters, **{name: value + t * direction})) for t, weight in stencil]
        except InputError:
            continue
    raise InputError(f"parameter {name}: it cannot vary along this direction within [{info.low:g}, {info.high:g}]")
