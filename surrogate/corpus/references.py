"""FEniCSx' answers to frames that projective dynamics simulated: converged on the same energy, and by another law."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

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
"""Gradient norm relative to that of rest in the frame's scene, or in settling to that of its start."""
ELEMENTS = {PD_ENERGY: "P2", "neo-Hookean": "P1"}
"""Of each law of FEM_LAWS."""


@dataclass(frozen=True, eq=False)
class Reference:
    """T - S (n, 3) [mm], "accepted" or why there is none, and iterations."""

    corrected: np.ndarray
    status: str
    iterations: int = 0


def references(plan: CorpusPlan, face: Face, frames: Sequence[tuple[Floats, Answer]]) -> Iterator[dict[str, Reference]]:
    """Solve frames, each of weights (52,) and the answer there is, with those of FEM_LAWS that the face has.

    Projective dynamics' energy by quadratic tets, which is its converged answer; another law on the face's own cells.
    Each stands on the neutral face settled by itself, and starts at the answer of projective dynamics; another law at
    the settled face where that answer has inverted tets. Where surfaces are near in that answer, they are kept apart by
    the pairs that it has. A frame of quadratic tets takes one to two minutes and up to 6 GB.
    """
    by_law = {law: _settle_by(face, law) for law in FEM_LAWS if _has_law(face, law)}
    for weights, answer in frames:
        positions = solve_frame(plan, face, weights).positions
        yield {law: _reference(face, own, weights, positions, answer, law) for law, own in by_law.items()}


def _has_law(face: Face, law: str) -> bool:
    """Whether a law has a counterpart of the face's p: none of stiffnesses that vary, a strain limit or growth."""
    try:
        apply_law(face.derivatives.prepared.scene, law)
    except SceneError:
        return False
    return True


def _settle_by(face: Face, law: str) -> Face:
    """Return the face whose frames a law's answers are: for PD's energy one that quadratic tets settle."""
    if law != PD_ENERGY:
        return face
    start = face.settled().positions
    settling = {"solver": "fenicsx", "element": ELEMENTS[law], "tolerance": TOLERANCE, "start": start}
    return replace(face, choices={**face.choices, "cells": "tets"}, settling=settling)


def _reference(face: Face, own: Face, weights: Floats, positions: Floats, answer: Answer, law: str) -> Reference:
    none = np.zeros(answer.corrected.shape, dtype=np.float16)
    try:
        neutral = own.settled(law)
        if not neutral.converged:
            raise SceneError(f"settling: {neutral.reason}")
        scene = face.derivatives.prepared.freeze_contact(positions, own.scene(weights, law))
        prepared = prepare(scene, solver="fenicsx", element=ELEMENTS[law])
        start = neutral.positions if law != PD_ENERGY and answer.inverted else positions
        # Relative to rest, or to small targets where that is the answer: at PD's own the gradient is rounding already.
        rest = prepared.solve(max_iterations=0).history.gradient_norm[0]
        solution = prepared.solve(start=start, absolute=TOLERANCE * max(rest, SMALL * spring_norm(scene)))
    except SoftdecaError as error:
        return Reference(none, f"fenicsx: {error}")
    if not solution.converged:
        return Reference(none, f"fenicsx: {solution.reason}", solution.iterations)
    corrected = (own.skin_after(weights, solution.positions, law) - face.blend(weights)).astype(np.float16)
    return Reference(corrected, reject_moved(corrected) or ACCEPTED, solution.iterations)
