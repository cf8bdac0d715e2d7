"""Derivatives of a settled face at its neutral expression: by blendshapes, and by the parameters p.

At a minimum the gradient stays zero, so K dx = -∂(∇E)/∂p dp with K the exact Hessian: one factor serves all changes.
What p does to the gradient is a difference quotient of scenes, which costs two gradients but no solve. Frames of one
identity and p start from the first-order answer and descend in the metric of K, so each depends on its own expression
alone, whatever was solved before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...lhm.base.checks import check_arguments
from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats
from ...lhm.head.head import LayeredHead
from .. import terms
from ..projective import Pattern, ProjectivePrepared, Tangent, prepare
from ..scene import Scene
from ..solution import OnIteration, Solution
from .palsy import Springs
from .parameters import Parameters
from .settle import SettledFace, neutral_scene

FRAME_ACCURACY, QUICK_ACCURACY, TIGHT_ACCURACY = 2.5e-5, 2e-6, 1e-8
"""Gradient norms, relative to that of the targets' springs each 1 mm long: of a frame, of a neutral answer that the PD
matrix reaches sooner than another factor is made, and of a tight neutral answer."""
BY_MATRIX = 400
"""Iterations of the PD matrix before the tangent takes over."""
STEP = 1e-4
"""Of the difference quotients, over a parameter's range."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """The symbolic work on a face, which serves every other of the same template and choices."""

    pattern: Pattern


class Rested(NamedTuple):
    """A settled face's neutral scene, prepared, and its answer by the PD matrix, which may not have converged."""

    prepared: ProjectivePrepared
    answer: Solution


@dataclass(frozen=True, eq=False)
class FaceDerivatives:
    """A settled face, prepared, with its neutral answer and the factored Hessian there.

    Names read like quotients: `skin_by_shapes` is how the skin moves per unit weight of blendshapes.
    """

    face: SettledFace
    prepared: ProjectivePrepared
    answer: Solution
    tangent: Tangent

    @property
    def is_exact(self) -> bool:
        """Whether the tangent is the exact Hessian, so that these are true derivatives; see `projective.Tangent`."""
        return self.tangent.is_exact

    @property
    def analysis(self) -> Analysis:
        """Symbolic work for `differentiate(like=...)`, kept when the numbers are let go."""
        return Analysis(self.tangent.pattern)

    @property
    def offset(self) -> Floats:
        """Simulated neutral skin minus its targets [mm], shape (skin vertices, 3)."""
        return self.face.skin_after(self.face.head.skin.vertices, self.answer.positions) - self.face.skin

    def vertices_by_shapes(self, deltas: Floats) -> Floats:
        """Differentiate the scene's vertices [mm], shape (k, n, 3), by weights of shapes.

        deltas [mm], shape (k, skin vertices, 3): what each shape adds to the skin.
        """
        moved = np.stack([self.face.head.wrap_from_skin @ delta for delta in deltas])
        springs = Springs.from_head(self.face.head, self.face.parameters)
        return self.tangent.vertices_by_targets(springs.move(moved))

    def skin_by_shapes(self, deltas: Floats, vertices: Floats | None = None) -> Floats:
        """Differentiate the skin [mm], shape (k, skin vertices, 3), by weights of shapes that add `deltas` to it.

        vertices: `vertices_by_shapes(deltas)`, where it is known.
        """
        vertices = self.vertices_by_shapes(deltas) if vertices is None else vertices
        activation = self.face.activation
        return _skin_by(self.face.head, vertices, deltas if activation is None else activation * deltas)

    def skin_by_parameters(self, along: Mapping[str, float | Floats]) -> dict[str, Floats]:
        """Differentiate the simulated neutral skin [mm], shape (skin vertices, 3), by parameters, as it settles anew.

        along: see `vertices_by_parameters`.
        """
        face, head = self.face, self.face.head
        prepared, near = _rest(neutral_scene(head, face.parameters, **face.choices), face.positions)
        settling = _factor(prepared, near, self.analysis)

        def settling_at(parameters: Parameters, targets: Floats) -> Scene:
            return neutral_scene(head, parameters, **face.choices)

        def scene_at(parameters: Parameters, targets: Floats) -> Scene:
            moved = SettledFace(head, parameters, face.positions, targets - head.skin.vertices, None, face.choices)
            return moved.scene(head.skin.vertices)

        settled = vertices_by_parameters(settling[1], settling_at, face.parameters, face.skin, along)
        drift = {name: head.skin_from_wrap @ move[: len(head.bone)] for name, move in settled.items()}
        moved = vertices_by_parameters(self.tangent, scene_at, face.parameters, face.skin, along, drift=drift)
        skins = _skin_by(head, np.stack(list(moved.values())), np.stack(list(drift.values())))
        return dict(zip(moved, skins, strict=True))

    def predict(self, expression: Floats) -> Floats:
        """Predict the scene's vertices [mm], shape (n, 3), to first order for an expression of the head without p."""
        moved = np.asarray(expression, dtype=np.float64) - self.face.head.skin.vertices
        return self.answer.positions + self.vertices_by_shapes(moved[None])[0]

    def solve(
        self,
        expression: Floats,
        *,
        accuracy: float = FRAME_ACCURACY,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
        untangle: bool = False,
    ) -> Solution:
        """Solve an expression [mm], shape (skin vertices, 3), of the head without p, from the first-order answer.

        accuracy is the gradient norm to stop at, relative to that of the targets' springs each 1 mm long. Raises what
        `facial_scene` and `projective` raise.
        """
        scene = self.face.scene(expression)
        return self.prepared.solve(
            scene,
            start=self.predict(expression),
            absolute=accuracy * spring_norm(scene),
            max_iterations=max_iterations,
            on_iteration=on_iteration,
            untangle=untangle,
            metric=self.tangent,
        )


@check_arguments
def differentiate(
    face: SettledFace,
    *,
    accuracy: float = TIGHT_ACCURACY,
    like: FaceDerivatives | Analysis | None = None,
    rested: Rested | None = None,
    on_iteration: OnIteration | None = None,
) -> FaceDerivatives:
    """Prepare a settled face's scenes, solve the neutral one and factor its Hessian.

    accuracy is the gradient norm of the neutral answer, relative to that of the targets' springs each 1 mm long: one
    factor does for QUICK_ACCURACY and above, below it takes two. `like`, another of the same template and choices,
    lends its symbolic work. `rested` is what `rest_among_targets` has made to this accuracy. `on_iteration` sees the
    neutral solve; what it raises ends all. Raises SceneError for choices with contact.
    """
    prepared, near = rest_among_targets(face, accuracy, on_iteration) if rested is None else rested
    analysis = like.analysis if isinstance(like, FaceDerivatives) else like
    return FaceDerivatives(face, prepared, *_factor(prepared, near, analysis, accuracy, on_iteration))


def rest_among_targets(
    face: SettledFace, accuracy: float = QUICK_ACCURACY, on_iteration: OnIteration | None = None
) -> Rested:
    """Prepare a settled face's neutral scene and solve it by the PD matrix, to `accuracy` or near enough for a tangent.

    accuracy and `on_iteration` as of `differentiate`.
    """
    return _rest(face.scene(face.head.skin.vertices), face.positions, accuracy, on_iteration)


def spring_norm(scene: Scene) -> float:
    """Return the gradient norm [mN] of the springs of a scene's first Target, each 1 mm long."""
    target = scene.of(terms.Target)[0]
    return float(np.linalg.norm(np.broadcast_to(target.stiffness, target.vertices.shape)))


def _rest(
    scene: Scene, start: Floats, accuracy: float = TIGHT_ACCURACY, on_iteration: OnIteration | None = None
) -> Rested:
    # By cholespy: its factor takes a tenth of a second more than CHOLMOD's from an analysis, each solve a third less.
    prepared = prepare(scene)
    first = max(accuracy, FRAME_ACCURACY if accuracy < QUICK_ACCURACY else 0.0) * spring_norm(scene)
    return Rested(
        prepared, prepared.solve(start=start, absolute=first, max_iterations=BY_MATRIX, on_iteration=on_iteration)
    )


def _factor(
    prepared: ProjectivePrepared,
    near: Solution,
    like: Analysis | None,
    accuracy: float = TIGHT_ACCURACY,
    on_iteration: OnIteration | None = None,
) -> tuple[Solution, Tangent]:
    """Factor the tangent at an answer, which goes on by that where it is not accurate yet."""
    tangent = prepared.tangent(near, like=None if like is None else like.pattern)
    if accuracy >= QUICK_ACCURACY and near.converged:
        return near, tangent
    answer = prepared.solve(
        start=near.positions,
        absolute=accuracy * spring_norm(prepared.scene),
        metric=tangent,
        untangle=False,
        on_iteration=on_iteration,
    )
    if answer.iterations:
        pattern = tangent.pattern
        del tangent  # before another factor is made: each is an eighth of a gigabyte
        tangent = prepared.tangent(answer, like=pattern)
    return answer, tangent


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


def _skin_by(head: LayeredHead, vertices: Floats, deltas: Floats) -> Floats:
    """Carry derivatives of the scene's vertices, shape (k, n, 3), over to the skin, whose targets move by `deltas`."""
    pairs = zip(vertices[:, : len(head.bone)], deltas, strict=True)
    return np.stack([delta + head.skin_from_wrap @ (wrap - head.wrap_from_skin @ delta) for wrap, delta in pairs])


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
