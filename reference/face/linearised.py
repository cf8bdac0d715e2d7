"""A settled face with its tangent at neutral: where expressions begin, and how the face answers to them and to p.

One factor serves all: frames of one identity and p start from the first-order answer and descend in the tangent's
metric, so each depends on its own expression alone, whatever was solved before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...lhm.base.checks import check_arguments
from ...lhm.base.geometry import cholesky
from ...lhm.base.geometry.cholesky import LinearSolver
from ...lhm.base.mesh import Floats
from .. import terms
from ..projective import Pattern, ProjectivePrepared, Tangent, prepare
from ..scene import Scene
from ..solution import OnIteration, Solution
from .parameters import Parameters
from .responses import expression_responses, parameter_responses, skin_responses
from .settling import Settled, neutral_scene

NEAR, DIRECT, TIGHT = 2.5e-5, 2e-6, 1e-8
"""Gradient norms, relative to that of the targets' springs each 1 mm long: of a first answer, of one that the PD matrix
reaches sooner than another factor is made, and of the last."""
DIRECTLY = 400
"""Iterations of the PD matrix before the tangent takes over."""


@dataclass(frozen=True, eq=False)
class Analysed:
    """What was analysed for a face, and serves every other of the same template and choices."""

    prepared: ProjectivePrepared
    tangent: Pattern


@dataclass(frozen=True, eq=False)
class Linearised:
    """A face prepared, its answer to the neutral expression, and the tangent there."""

    face: Settled
    prepared: ProjectivePrepared
    answer: Solution
    tangent: Tangent

    @property
    def exact(self) -> bool:
        """Whether the tangent is the exact Hessian, so that responses are derivatives; see `projective.Tangent`."""
        return self.tangent.exact

    @property
    def analysed(self) -> Analysed:
        """What another face may be `linearised` like, when this one is let go."""
        return Analysed(self.prepared, self.tangent.pattern)

    @property
    def offset(self) -> Floats:
        """By how much the simulated neutral skin differs from its targets [mm], shape (skin vertices, 3)."""
        return self.face.skin_after(self.face.head.skin.vertices, self.answer.positions) - self.face.skin

    def first_order(self, deltas: Floats) -> Floats:
        """How the scene's vertices move [mm], (k, n, 3), per unit weight of shapes that add `deltas` to the skin."""
        return expression_responses(self.tangent, self.face.head, self.face.parameters, deltas)

    def start(self, expression: Floats) -> Floats:
        """The first-order answer [mm], shape (scene's vertices, 3), to an expression of the head without p."""
        moved = np.asarray(expression, dtype=np.float64) - self.face.head.skin.vertices
        return self.answer.positions + self.first_order(moved[None])[0]

    def solve(
        self,
        expression: Floats,
        *,
        accuracy: float = NEAR,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
        untangle: bool = False,
    ) -> Solution:
        """The scene of an expression [mm], shape (skin vertices, 3), of the head without p, solved from `start`.

        accuracy is the gradient norm to stop at, relative to that of the targets' springs each 1 mm long. Raises what
        `facial_scene` and `projective` raise.
        """
        scene = self.face.scene(expression)
        return self.prepared.solve(
            scene,
            start=self.start(expression),
            absolute=accuracy * spring_norm(scene),
            max_iterations=max_iterations,
            on_iteration=on_iteration,
            untangle=untangle,
            metric=self.tangent,
        )

    def of_expressions(self, deltas: Floats) -> Floats:
        """How the skin moves [mm], (k, skin vertices, 3), per unit weight of shapes that add `deltas` to it."""
        return self.skin_moved(self.first_order(deltas), deltas)

    def skin_moved(self, moved: Floats, deltas: Floats) -> Floats:
        """How the skin moves [mm], (k, skin vertices, 3), where `deltas` move the scene's vertices by `first_order`."""
        kept = self.face.kept
        return skin_responses(self.face.head, moved, deltas if kept is None else kept * deltas)

    def of_parameters(self, along: Mapping[str, float | Floats]) -> dict[str, Floats]:
        """How the simulated neutral skin moves [mm], (skin vertices, 3), per unit of parameters, as it settles anew.

        along: see `responses.parameter_responses`.
        """
        face, head = self.face, self.face.head
        settling = _tangent_of(neutral_scene(head, face.parameters, **face.choices), face.positions, self)

        def settling_at(parameters: Parameters, targets: Floats) -> Scene:
            return neutral_scene(head, parameters, **face.choices)

        def scene_at(parameters: Parameters, targets: Floats) -> Scene:
            return Settled(head, parameters, face.positions, targets - head.skin.vertices, None, face.choices).scene(
                head.skin.vertices
            )

        moved = parameter_responses(settling[2], settling_at, face.parameters, face.skin, along)
        drift = {name: head.skin_from_wrap @ move[: len(head.bone)] for name, move in moved.items()}
        found = parameter_responses(self.tangent, scene_at, face.parameters, face.skin, along, drift=drift)
        skins = skin_responses(head, np.stack(list(found.values())), np.stack(list(drift.values())))
        return dict(zip(found, skins, strict=True))


@check_arguments
def linearised(face: Settled, *, accuracy: float = TIGHT, like: Linearised | Analysed | None = None) -> Linearised:
    """Prepare a settled face's scenes, solve the neutral one tightly and factor its tangent.

    accuracy is the gradient norm of the neutral answer, relative to that of the targets' springs each 1 mm long: one
    factor does for DIRECT and above, below it takes two. `like`, another of the same template and choices, lends what
    was analysed. Raises SceneError for choices with contact.
    """
    scene = face.scene(face.head.skin.vertices)
    return Linearised(face, *_tangent_of(scene, face.positions, like, accuracy))


def spring_norm(scene: Scene) -> float:
    """The gradient norm [mN] of the springs of a scene's first Target, each 1 mm long."""
    target = scene.of(terms.Target)[0]
    return float(np.linalg.norm(np.broadcast_to(target.stiffness, target.vertices.shape)))


def _tangent_of(
    scene: Scene, start: Floats, like: Linearised | Analysed | None, accuracy: float = TIGHT
) -> tuple[ProjectivePrepared, Solution, Tangent]:
    """A scene prepared and solved: by the PD matrix, where need be then by the tangent; and the tangent in the end."""
    linear_solver: LinearSolver | None = None if cholesky.cholmod_library() is None else "cholmod"
    prepared = prepare(scene, linear_solver=linear_solver, like=None if like is None else like.prepared)
    norm = spring_norm(scene)
    direct = accuracy >= DIRECT
    near = prepared.solve(start=start, absolute=(accuracy if direct else NEAR) * norm, max_iterations=DIRECTLY)
    tangent = prepared.tangent(near, like=None if like is None else like.tangent)
    if direct and near.converged:
        return prepared, near, tangent
    answer = prepared.solve(start=near.positions, absolute=accuracy * norm, metric=tangent, untangle=False)
    if answer.iterations:
        pattern = tangent.pattern
        del tangent  # before another factor is made: each is an eighth of a gigabyte
        tangent = prepared.tangent(answer, like=pattern)
    return prepared, answer, tangent
