"""Simulations of a face for a corpus: settled and differentiated once, then asked for expressions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...lhm.base.errors import SceneError, SoftdecaError
from ...lhm.base.geometry.bvh import TriangleTree
from ...lhm.base.mesh import Floats, Floats32, Surface
from ...lhm.head.head import LayeredHead
from ...reference import Solution
from ...reference.face.derivatives import spring_norm
from ...reference.face.face import Face
from ...reference.face.tissue import CellKind
from .face import MOVED, People, Person
from .mixture import ParameterSet
from .plan import CorpusPlan
from .shard import ACCEPTED


@dataclass(frozen=True, eq=False)
class Answer:
    """One frame: T - S (n, 3) [mm], and columns of `shard.Statics` on its solve."""

    corrected: np.ndarray
    status: str
    moved: tuple[float, float] = (0.0, 0.0)
    iterations: int = 0
    residual: float = 0.0
    smallest_volume_ratio: float = 0.0
    inverted: int = 0
    crossings: int = 0

    @classmethod
    def failed(cls, status: str, skin: Surface) -> Answer:
        """Make the answer of a frame that failed."""
        return cls(np.zeros(skin.vertices.shape, dtype=np.float16), status)


def make_face(
    people: People,
    person: Person,
    head: LayeredHead,
    parameters: ParameterSet,
    *,
    contact: bool = False,
    cells: CellKind = "prisms",
) -> Face:
    """Make a person's face under a parameter set."""
    on_wraps = parameters.parameters(head, people.mean)
    face = Face(head, person.shapes, on_wraps, per="wraps", code=person.code, choices={"cells": cells})
    return face.in_contact() if contact else face


def prepare_face(face: Face) -> None:
    """Settle and differentiate a face before its frames; SceneError where it does not come to rest."""
    neutral = face.settled()
    if not neutral.converged:
        raise SceneError(str(neutral.reason))
    if reason := reject_moved(neutral.displacement):
        raise SceneError(reason)
    _ = face.first_order


def reject_moved(displacements: np.ndarray, farthest: float = MOVED) -> str:
    """Say why displacements [mm] are not kept in a corpus; empty where they are."""
    return "" if (np.abs(displacements) <= farthest).all() else f"a vertex moves farther than {farthest:g} mm"


def solve_frame(plan: CorpusPlan, face: Face, weights: Floats | Floats32) -> Solution:
    """Solve an expression, begun at the first-order answer, or at the neutral one where surfaces touch there.

    By the PD matrix, whose factor stays in a core's cache; where that fails, in the tangent's metric.
    """
    scene, linear = face.scene(weights), face.derivatives
    start = linear.answer.positions + np.tensordot(weights, face.first_order, axes=1)
    if linear.prepared.touches(start):
        start = linear.answer.positions
    stop = plan.tolerance * spring_norm(scene)
    spent = 0
    for metric in (None, linear.tangent):
        solution = linear.prepared.solve(
            scene, start=start, absolute=stop, max_iterations=plan.max_iterations, metric=metric, untangle=False
        )
        spent += solution.iterations
        if solution.converged:
            break
        start = solution.positions if np.isfinite(solution.positions).all() else start
    return replace(solution, iterations=spent)


def simulate_static(plan: CorpusPlan, face: Face, weights: Floats | Floats32) -> Answer:
    """Simulate one static frame; a failure is a status."""
    try:
        return describe_answer(plan, face, weights, solve_frame(plan, face, weights))
    except SoftdecaError as error:
        return Answer.failed(f"scene: {error}", face.skin)


def describe_answer(plan: CorpusPlan, face: Face, weights: Floats | Floats32, solution: Solution) -> Answer:
    """Make the answer that a corpus keeps of a solution."""
    corrected = (face.skin_after(weights, solution.positions) - face.blend(weights)).astype(np.float16)
    inverted = solution.volume_ratio <= 0.0
    distances = np.linalg.norm(corrected[_find_face(face.head)].astype(np.float64), axis=1)
    crossings, wrap = 0, face.head.skin_wrap
    if np.isfinite(solution.positions).all():
        tree = TriangleTree(solution.positions[: len(wrap.vertices)], wrap.triangles)
        crossings = len(tree.self_crossings())
    return Answer(
        corrected=corrected,
        status=_judge(plan, face.head, solution, inverted, corrected),
        moved=(float(distances.mean()), float(np.percentile(distances, 95.0))),
        iterations=solution.iterations,
        residual=float(solution.history.gradient_norm[-1]) / spring_norm(face.derivatives.prepared.scene),
        smallest_volume_ratio=float(solution.volume_ratio.min()),
        inverted=int(np.count_nonzero(inverted)),
        crossings=crossings,
    )


def _find_face(head: LayeredHead) -> np.ndarray:
    """Whether each skin vertex is of the face, shape (n,); all where the head does not tell."""
    return head.on_skin(["face"]) if "face" in head.regions else np.ones(len(head.skin.vertices), dtype=bool)


def _judge(plan: CorpusPlan, head: LayeredHead, solution: Solution, inverted: np.ndarray, corrected: np.ndarray) -> str:
    soft = np.count_nonzero(inverted[: len(head.soft.tets)])
    if not solution.converged:
        return f"solver: {solution.reason}"
    if soft or inverted.mean() > plan.inverted_share:
        return f"{np.count_nonzero(inverted)} inverted tets, {soft} of them in soft tissue"
    return reject_moved(corrected) or ACCEPTED
