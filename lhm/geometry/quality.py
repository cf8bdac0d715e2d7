"""Shape of tets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mesh import Floats, Ints, tet_volumes


def smallest_dihedrals(vertices: Floats, tets: Ints) -> Floats:
    """The smallest of the six angles [degrees] between the faces of each tet, shape (m,)."""
    x = vertices[tets]
    faces = [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]
    normals = np.stack([np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]) for i, j, k in faces], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-30)
    smallest = np.full(len(tets), 180.0)
    for i in range(4):
        for j in range(i):
            cosine = -np.einsum("md,md->m", normals[:, i], normals[:, j])
            smallest = np.minimum(smallest, np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return smallest


def aspect_ratios(vertices: Floats, tets: Ints) -> Floats:
    """Longest edge over smallest height of each tet, shape (m,): 1.22 if regular, and large if flat or thin."""
    x = vertices[tets]
    edges = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    longest = np.sqrt(np.max([((x[:, j] - x[:, i]) ** 2).sum(axis=1) for i, j in edges], axis=0))
    faces = [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]
    doubled = [np.linalg.norm(np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]), axis=1) for i, j, k in faces]
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
