"""Tets made upright by moving vertices that are free to lie elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from .errors import MeshError
from .mesh import Floats, Ints, tet_volumes

ITERATIONS = 500
REACHED = 0.5
"""The share of the volume asked for that passes: the last bit of it is slow to come."""


def untangled(vertices: Floats, tets: Ints, free: NDArray[np.bool_], least: Floats) -> Floats:
    """Vertices [mm], shape (n, 3), of which those `free` (n,) that touch too small a tet are moved until it is not.

    `least` (m,) [mm³] is the volume asked for. The squared shortfalls, each over its `least`, are minimised by L-BFGS.
    Raises MeshError with the number of tets that stay inverted or below half of what was asked for.
    """
    small = tet_volumes(vertices, tets) < least
    if not small.any():
        return vertices
    moving = np.unique(tets[small])
    moving = moving[free[moving]]
    around = np.isin(tets, moving).any(axis=1)
    touched, asked = tets[around], least[around]
    x = np.array(vertices)

    def shortfall(flat: Floats) -> tuple[float, Floats]:
        x[moving] = flat.reshape(-1, 3)
        a, b, c, d = (x[touched[:, k]] for k in range(4))
        opposite = [np.cross(c - a, d - a), np.cross(d - a, b - a), np.cross(b - a, c - a)]
        missing = np.maximum(1.0 - np.einsum("md,md->m", opposite[2], d - a) / (6.0 * asked), 0.0)
        slope = (-missing / (3.0 * asked))[:, None]
        gradient = np.zeros_like(x)
        np.add.at(gradient, touched[:, 0], -slope * sum(opposite))
        for corner in (1, 2, 3):
            np.add.at(gradient, touched[:, corner], slope * opposite[corner - 1])
        return float(missing @ missing), gradient[moving].ravel()

    if moving.size:
        found = minimize(shortfall, x[moving].ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
        x[moving] = found.x.reshape(-1, 3)
    stuck = int(np.count_nonzero(tet_volumes(x, tets) < REACHED * least))
    if stuck:
        raise MeshError(f"tets: {stuck} stay inverted or all but flat wherever the vertices between the wraps are put")
    return x
