"""How a settled face answers to small changes: of its expression, and of each parameter of p.

At a minimum the gradient stays zero, so K dx = -∂(∇E)/∂p dp with K the exact Hessian: one factor serves all changes.
What p does to the gradient is a difference quotient of scenes, which costs two gradients but no solve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats
from ...lhm.head import LayeredHead
from ..scene import Scene
from .palsy import Springs
from .parameters import Parameters

STEP = 1e-4
"""Of the difference quotients, over a parameter's range."""


class Tangent(Protocol):
    """A factored Hessian at an answer; see `projective.Tangent`."""

    def of_targets(self, moved: Floats) -> Floats:
        """How vertices move where the first Target's positions do."""
        ...

    def of_scenes(self, changes: Iterable[Iterable[tuple[Scene, float]]]) -> Floats:
        """How vertices move where the scene changes by difference quotients, each scene let go when it has served."""
        ...


def expression_responses(tangent: Tangent, head: LayeredHead, parameters: Parameters, deltas: Floats) -> Floats:
    """How the scene's vertices move [mm], shape (k, n, 3), per unit weight of shapes that add `deltas` to the skin.

    deltas [mm], shape (k, skin vertices, 3). How the skin itself moves is told by `skin_responses`.
    """
    moved = np.stack([head.wrap_from_skin @ delta for delta in deltas])
    return tangent.of_targets(Springs.of(head, parameters).moved(moved))


def parameter_responses(
    tangent: Tangent,
    scene_at: Callable[[Parameters, Floats], Scene],
    parameters: Parameters,
    targets: Floats,
    along: Mapping[str, float | Floats],
    *,
    drift: Mapping[str, Floats] | None = None,
) -> dict[str, Floats]:
    """How the scene's vertices move [mm], shape (n, 3), per unit of parameters, by name.

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
    return dict(zip(along, tangent.of_scenes(changes), strict=True))


def skin_responses(head: LayeredHead, moved: Floats, deltas: Floats | None = None) -> Floats:
    """How the skin moves [mm], shape (k, skin vertices, 3), where the scene's vertices move by (k, n, 3).

    deltas: how the expression moves along, if it does; see `LayeredHead.skin_after`.
    """
    wrap = np.asarray(moved)[:, : len(head.bone)]
    if deltas is None:
        return np.stack([head.skin_from_wrap @ move for move in wrap])
    pairs = zip(wrap, deltas, strict=True)
    return np.stack([delta + head.skin_from_wrap @ (move - head.wrap_from_skin @ delta) for move, delta in pairs])


def _quotient(parameters: Parameters, name: str, direction: float | Floats) -> list[tuple[float, float, Parameters]]:
    """Steps t, weights, and parameters changed by t along a direction: central, or one-sided inwards."""
    info = Parameters.info(name)
    size = float(np.max(np.abs(direction)))
    if not (np.isfinite(size) and size > 0.0):
        raise InputError(f"parameter {name}: a direction to vary it along must be finite and not zero")
    h = STEP * (info.high - info.low) / size
    for stencil in (((h, 0.5 / h), (-h, -0.5 / h)), *(_one_sided(side * h) for side in (1.0, -1.0))):
        value = getattr(parameters, name)
        try:
            return [(t, weight, replace(parameters, **{name: value + t * direction})) for t, weight in stencil]
        except InputError:
            continue
    raise InputError(f"parameter {name}: it cannot vary along this direction within [{info.low:g}, {info.high:g}]")


def _one_sided(h: float) -> tuple[tuple[float, float], ...]:
    """f'(0) = (-3 f(0) + 4 f(h) - f(2 h)) / (2 h), of second order."""
    return (0.0, -1.5 / h), (h, 2.0 / h), (2.0 * h, -0.5 / h)
