"""Shape of tets."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints


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
