"""Quantities inside a face: displacement of all vertices, stress of each layer, and the mandible's place."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....lhm.base.geometry.warp import rigid_motion
from ....lhm.base.mesh import Floats, Ints
from ....lhm.head.head import MANDIBLE, LayeredHead
from ....reference import Solution
from ...contest import Made
from ..measures import difference

LAYERS = ("soft", "muscle")


def compare_insides(head: LayeredHead, own: Made, true: Made) -> dict[str, Any]:
    """Compare two solvers' frames inside: all vertices, the mandible's place, and the own stress by layer.

    Nothing of frames that nobody solved for.
    """
    if own.positions is None or true.positions is None:
        return {}
    solution = own.rig.last.solution
    return {
        "inside": difference(own.positions, true.positions, head.vertices),
        "mandible": mandible_apart(head, own.positions, true.positions),
        "stress": None if solution is None else stress_by_layer(head, solution),
    }


def stress_by_layer(head: LayeredHead, solution: Solution) -> dict[str, dict[str, float]]:
    """Give von Mises stress [kPa] of soft tissue and muscle: mean over the volume at rest.

    Stresses are of the tets' own terms: the skin's membrane is none of them.
    """
    first, figures = 0, {}
    for name, layer in zip(LAYERS, (head.soft, head.muscle), strict=True):
        stress = solution.von_mises[first : first + len(layer.tets)]
        first += len(layer.tets)
        figures[name] = {"mean": float(np.average(stress, weights=layer.volumes))}
    return figures


def mandible(head: LayeredHead) -> Ints:
    """Give the indices of the mandible's vertices in a scene of one layer of tets per tissue."""
    return 2 * len(head.bone) + np.flatnonzero(head.bone == MANDIBLE)


def mandible_apart(head: LayeredHead, positions: Floats, others: Floats) -> dict[str, float]:
    """Give how far two answers' mandibles are apart: mean distance [mm] of their vertices, and the turn [degrees]."""
    ids = mandible(head)
    if len(ids) < 3:
        return {"mm": 0.0, "degrees": 0.0}
    rotation, _ = rigid_motion(others[ids], positions[ids])
    # The sine keeps small angles that the cosine rounds away.
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    angle = np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1.0)
    apart = np.linalg.norm(positions[ids] - others[ids], axis=1)
    return {"mm": float(apart.mean()), "degrees": float(np.degrees(angle))}
