"""What FEniCSx says of a frame that projective dynamics simulated: on the same energy, and with the neo-Hookean law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.errors import SoftdecaError
from ...lhm.mesh import Floats
from ...reference import neo_hookean_scene, prepare
from ...reference.face.linearised import spring_norm
from .group import Answer, Group
from .shard import ACCEPTED

FEM_LAWS = ("PD", "neo-Hookean")
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


def references(group: Group, weights: Floats, answer: Answer) -> list[Reference]:
    """A frame by FEniCSx with each of FEM_LAWS; it starts at the answer of projective dynamics."""
    positions = group.solve(weights).positions
    return [_reference(group, weights, positions, answer, law) for law in FEM_LAWS]


def _reference(group: Group, weights: Floats, positions: Floats, answer: Answer, law: str) -> Reference:
    none = np.zeros(answer.corrected.shape, dtype=np.float16)
    try:
        scene = group.scene(weights)
        prepared = prepare(scene if law == FEM_LAWS[0] else neo_hookean_scene(scene), solver="fenicsx")
        # Relative to rest, or to small targets where that is the answer: at PD's own the gradient is rounding already.
        rest = prepared.solve(max_iterations=0).history.gradient_norm[0]
        solution = prepared.solve(start=positions, absolute=TOLERANCE * max(rest, SMALL * spring_norm(scene)))
    except SoftdecaError as error:
        return Reference(none, f"fenicsx: {error}")
    if not solution.converged:
        return Reference(none, f"fenicsx: {solution.reason}", solution.iterations)
    return Reference(group.corrected(weights, solution.positions).astype(np.float16), ACCEPTED, solution.iterations)
