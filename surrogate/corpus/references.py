"""FEniCSx' answers to a frame that projective dynamics simulated: on the same energy, and with the neo-Hookean law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import SceneError, SoftdecaError
from ...lhm.base.mesh import Floats
from ...reference import apply_law, prepare
from ...reference.face.derivatives import spring_norm
from ...reference.face.face import Face
from ...reference.face.facial import PD_ENERGY
from .plan import CorpusPlan
from .shard import ACCEPTED, FEM_LAWS
from .simulator import Answer, reject_moved, solve_frame

SMALL = 1e-2
"""[mm] Targets' distance whose springs' force is asked for relative to, at the least."""
TOLERANCE = 1e-6
"""Gradient norm relative to that of rest in the frame's scene."""


@dataclass(frozen=True, eq=False)
class Reference:
    """T - S (n, 3) [mm], "accepted" or why there is none, and iterations."""

    corrected: np.ndarray
    status: str
    iterations: int = 0


def references(plan: CorpusPlan, face: Face, weights: Floats, answer: Answer) -> dict[str, Reference]:
    """Solve a frame by FEniCSx with those of FEM_LAWS that the face has, each on the neutral face settled by that law.

    FEniCSx starts at the answer of projective dynamics, or at the settled face where that answer has inverted tets.
    Where surfaces are near in that answer, they are kept apart by the pairs that it has.
    """
    positions = solve_frame(plan, face, weights).positions
    return {law: _reference(face, weights, positions, answer, law) for law in FEM_LAWS if _has_law(face, law)}


def _has_law(face: Face, law: str) -> bool:
    """Whether a law has a counterpart of the face's p: none of stiffnesses that vary, a strain limit or growth."""
    try:
        apply_law(face.derivatives.prepared.scene, law)
    except SceneError:
        return False
    return True


def _reference(face: Face, weights: Floats, positions: Floats, answer: Answer, law: str) -> Reference:
    none = np.zeros(answer.corrected.shape, dtype=np.float16)
    try:
        neutral = face.settled(law)
        if not neutral.converged:
            raise SceneError(f"settling: {neutral.reason}")
        scene = face.derivatives.prepared.freeze_contact(positions, face.scene(weights, law))
        prepared = prepare(scene, solver="fenicsx")
        start = neutral.positions if law != PD_ENERGY and answer.inverted else positions
        # Relative to rest, or to small targets where that is the answer: at PD's own the gradient is rounding already.
        rest = prepared.solve(max_iterations=0).history.gradient_norm[0]
        solution = prepared.solve(start=start, absolute=TOLERANCE * max(rest, SMALL * spring_norm(scene)))
    except SoftdecaError as error:
        return Reference(none, f"fenicsx: {error}")
    if not solution.converged:
        return Reference(none, f"fenicsx: {solution.reason}", solution.iterations)
    corrected = (face.skin_after(weights, solution.positions, law) - face.blend(weights)).astype(np.float16)
    return Reference(corrected, reject_moved(corrected) or ACCEPTED, solution.iterations)
