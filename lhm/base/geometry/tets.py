"""The shape of tets, and tets made upright by moving vertices that are free to lie elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ..errors import MeshError
from ..mesh import FACES, Floats, Ints, tet_volumes


def smallest_dihedrals(vertices: Floats, tets: Ints) -> Floats:
    """Return the smallest of the six angles [degrees] between the faces of each tet, shape (m,)."""
    x = vertices[tets]
    normals = np.stack([np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]) for i, j, k in FACES], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-30)
    smallest = np.full(len(tets), 180.0)
    for i in range(4):
        for j in range(i):
            cosine = -np.einsum("md,md->m", normals[:, i], normals[:, j])
            smallest = np.minimum(smallest, np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return smallest


def aspect_ratios(vertices: Floats, tets: Ints) -> Floats:
    """Return longest edge over smallest height of each tet, shape (m,): 1.22 if regular, large if flat or thin."""
    x = vertices[tets]
    edges = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    longest = np.sqrt(np.max([((x[:, j] - x[:, i]) ** 2).sum(axis=1) for i, j in edges], axis=0))
    doubled = [np.linalg.norm(np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]), axis=1) for i, j, k in FACES]
    # Height over a face = 3 volumes / area.
    height = 6.0 * np.abs(tet_volumes(vertices, tets)) / np.maximum(np.max(doubled, axis=0), 1e-30)
    return longest / np.maximum(height, 1e-30)


@dataclass(frozen=True)
class TetQuality:
    """Shape of some tets: volumes [mm³], smallest angles between faces [degrees], aspect ratios (1.22 if regular)."""

    tets: int
    volume: float
    least_volume: float
    smallest_dihedral: float
    share_below_2_degrees: float
    share_below_5_degrees: float
    aspect_median: float
    aspect_95: float
    aspect_max: float


def tet_quality(vertices: Floats, tets: Ints) -> TetQuality:
    """Measure tets, shape (m, 4), of which there is at least one, over vertices [mm], shape (n, 3)."""
    volumes, angles, aspects = (f(vertices, tets) for f in (tet_volumes, smallest_dihedrals, aspect_ratios))
    return TetQuality(
        tets=len(tets),
        volume=float(volumes.sum()),
        least_volume=float(volumes.min()),
        smallest_dihedral=float(angles.min()),
        share_below_2_degrees=float((angles < 2).mean()),
        share_below_5_degrees=float((angles < 5).mean()),
        aspect_median=float(np.median(aspects)),
        aspect_95=float(np.quantile(aspects, 0.95)),
        aspect_max=float(aspects.max()),
    )


ITERATIONS = 500
REACHED = 0.5
"""The share of the volume wanted that passes: the last bit of it is slow to come."""


def untangle(vertices: Floats, tets: Ints, free: NDArray[np.bool_], least: Floats) -> Floats:
    """Move the `free` (n,) of the vertices [mm], shape (n, 3), that touch too small a tet until it is not.

    `least` (m,) [mm³] is the volume wanted. The squared shortfalls, each over its `least`, are minimised by L-BFGS.
    Raises MeshError with the number of tets that stay inverted or below half of that.
    """
    small = tet_volumes(vertices, tets) < least
    if not small.any():
        return vertices
    moving = np.unique(tets[small])
    moving = moving[free[moving]]
    around = np.isin(tets, moving).any(axis=1)
    touched, wanted = tets[around], least[around]
    x = np.array(vertices)

    def shortfall(flat: Floats) -> tuple[float, Floats]:
        x[moving] = flat.reshape(-1, 3)
        a, b, c, d = (x[touched[:, k]] for k in range(4))
        opposite = [np.cross(c - a, d - a), np.cross(d - a, b - a), np.cross(b - a, c - a)]
        missing = np.maximum(1.0 - np.einsum("md,md->m", opposite[2], d - a) / (6.0 * wanted), 0.0)
        slope = (-missing / (3.0 * wanted))[:, None]
        gradient = np.zeros_like(x)
        np.add.at(gradient, touched[:, 0], -slope * sum(opposite))
        for corner in (1, 2, 3):
            np.add.at(gradient, touched[:, corner], slope * opposite[corner - 1])
        return float(missing @ missing), gradient[moving].ravel()

    if moving.size:
        solution = minimize(shortfall, x[moving].ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
        x[moving] = solution.x.reshape(-1, 3)
    stuck = int(np.count_nonzero(tet_volumes(x, tets) < REACHED * least))
    if stuck:
        raise MeshError(f"tets: {stuck} stay inverted or all but flat wherever the vertices between the wraps are put")
    return x
