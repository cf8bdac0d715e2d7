"""The geodesic sphere."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints


def geodesic_sphere(frequency: int) -> tuple[Floats, Ints]:
    """Return the unit icosphere whose edges are cut into `frequency` parts: 10 f² + 2 vertices, 20 f² triangles.

    It is its own mirror image at x = 0. Vertices rise in y, then in z, so that twins follow one another, and a vertex
    has a smaller number than its neighbour where its twin has.
    """
    from trimesh.creation import icosahedron  # it takes a quarter of what this package takes to load

    base = icosahedron()
    rows = [(i, j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    place = {ij: k for k, ij in enumerate(rows)}
    weights = np.array([(frequency - i - j, i, j) for i, j in rows]) / frequency
    local = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i, j in rows if i + j < frequency]
    local += [(place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]) for i, j in rows if i + j < frequency - 1]
    points = np.einsum("kc,fcd->fkd", weights, np.asarray(base.vertices)[base.faces]).reshape(-1, 3)
    triangles = (np.array(local)[None] + len(rows) * np.arange(len(base.faces))[:, None, None]).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    _, first, number = np.unique(np.round(points[:, [1, 2, 0]], 9), axis=0, return_index=True, return_inverse=True)
    return points[first], number.ravel()[triangles]
