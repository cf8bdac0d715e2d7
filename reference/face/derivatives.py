"""Derivatives of a settled face at an answer: at the neutral one by blendshapes, at a frame by p.

At a minimum the gradient stays zero, so K dx = -∂(∇E)/∂p dp with K the exact Hessian: one factor serves all changes.
Frames of one face start from the first-order answer, so each depends on its own expression alone, whatever was solved
before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from ...lhm.head.head import LayeredHead
from .. import terms
from ..projective import ProjectivePrepared, Tangent, prepare
from ..scene import Scene
from ..solution import OnIteration, Solution

FRAME_ACCURACY, QUICK_ACCURACY, TIGHT_ACCURACY = 2.5e-5, 2e-6, 1e-8
"""Gradient norms, relative to that of the targets' springs each 1 mm long: of a frame, of a neutral answer that the PD
matrix reaches sooner than another factor is made, and of a tight neutral answer."""
BY_MATRIX = 400
"""Iterations of the PD matrix before the tangent takes over."""


Rested = tuple[ProjectivePrepared, Solution]
"""A face's scene, prepared, and its answer by the PD matrix, which may not have converged."""


@dataclass(frozen=True, eq=False)
class FaceDerivatives:
    """A face's scene, prepared, with its answer and the factored Hessian there."""

    prepared: ProjectivePrepared
    answer: Solution
    tangent: Tangent

    @property
    def is_exact(self) -> bool:
        """Whether the tangent is the exact Hessian, so that these are true derivatives; see `projective.Tangent`."""
        return self.tangent.is_exact


def rest_among_targets(
    scene: Scene, start: Floats, accuracy: float = QUICK_ACCURACY, on_iteration: OnIteration | None = None
) -> Rested:
    """Prepare a face's scene and solve it by the PD matrix, to `accuracy` or near enough for a tangent.

    start: the settled face's positions [mm]. accuracy is the gradient norm of the answer, relative to that of the
    targets' springs each 1 mm long. `on_iteration` sees the solve; what it raises ends it.
    """
    prepared = prepare(scene)
    first = max(accuracy, FRAME_ACCURACY if accuracy < QUICK_ACCURACY else 0.0) * spring_norm(scene)
    return prepared, prepared.solve(start=start, absolute=first, max_iterations=BY_MATRIX, on_iteration=on_iteration)


def differentiate(
    rested: Rested,
    *,
    accuracy: float = QUICK_ACCURACY,
    on_iteration: OnIteration | None = None,
) -> FaceDerivatives:
    """Factor the Hessian at an answer, and refine the answer by it where it is not accurate yet.

    accuracy as of `rest_among_targets`: one factor does for QUICK_ACCURACY and above, below it takes two.
    """
    prepared, near = rested
    tangent = prepared.tangent(near)
    if accuracy >= QUICK_ACCURACY and near.converged:
        return FaceDerivatives(prepared, near, tangent)
    answer = prepared.solve(
        start=near.positions,
        absolute=accuracy * spring_norm(prepared.scene),
        metric=tangent,
        untangle=False,
        on_iteration=on_iteration,
    )
    if answer.iterations:
        del tangent  # before another factor is made: each is an eighth of a gigabyte
        tangent = prepared.tangent(answer)
    return FaceDerivatives(prepared, answer, tangent)


def spring_norm(scene: Scene) -> float:
    """Return the gradient norm [mN] of the springs of a scene's first Target, each 1 mm long."""
    target = scene.of(terms.Target)[0]
    return float(np.linalg.norm(np.broadcast_to(target.stiffness, target.vertices.shape)))


def carry_to_skin(head: LayeredHead, vertices: Floats, deltas: Floats) -> Floats:
    """Carry derivatives of the scene's vertices, shape (k, n, 3), over to the skin, whose targets move by `deltas`."""
    pairs = zip(vertices[:, : len(head.bone)], deltas, strict=True)
    return np.stack([delta + head.skin_from_wrap @ (wrap - head.wrap_from_skin @ delta) for wrap, delta in pairs])
