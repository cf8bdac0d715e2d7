"""The neck's end of the default people: drawings cut it by a plane, since it ends ragged where a scan has no neck."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from ..base.geometry.topology import connected_parts, graph_laplacian, neighbours, pick_rows, unique_edges
from ..base.mesh import Floats, Ints, Surface
from .space import CAP, OUTSIDE, rim_of

ABOVE, MOST = 3.0, 25.0
"""[mm] The plane lies so far above the rim's highest vertex, and at most so far above the rim's middle."""


def cut_neck(skin: Surface, parts: Ints) -> csr_matrix:
    """Return weights (n, n), rows of sum one, that lay the neck's end of a skin at rest into a plane.

    The plane is parallel to that of the rim around the CAP in `parts` (n,). Vertices below it go to the nearest point
    at which it cuts an edge, the CAP between those of its rim. Both move with the skin.
    """
    x, triangles, n = skin.vertices, skin.triangles, len(skin.vertices)
    rim, cap = rim_of(triangles, parts, CAP), np.flatnonzero(parts == CAP)
    normal, height = _find_plane(x, rim)
    outside = triangles[(parts[triangles] == OUTSIDE).all(axis=1)]
    piece = connected_parts(outside[(height[outside] < 0.0).all(axis=1)], n)[1]
    below = (height < 0.0) & (parts == OUTSIDE) & np.isin(piece, piece[rim])
    lower = np.flatnonzero(below)

    edges = unique_edges(outside)
    edges = edges[below[edges[:, 0]] != below[edges[:, 1]]]
    share = height[edges] / (height[edges[:, 0]] - height[edges[:, 1]])[:, None]
    crossed = np.repeat(np.arange(len(edges)), 2), edges.ravel()
    cuts = csr_matrix((np.stack([-share[:, 1], share[:, 0]], axis=1).ravel(), crossed), (len(edges), n))
    nearest = cKDTree(cuts @ x).query(x[lower] - height[lower, None] * normal)[1]
    wall = diags((~below).astype(np.float64)) + pick_rows(lower, n).T @ cuts[nearest]

    laplacian = graph_laplacian(neighbours(triangles, n)).tocsc()
    within = csr_matrix(spsolve(laplacian[cap][:, cap], -laplacian[cap][:, rim]))
    lid = pick_rows(cap, n).T @ within @ pick_rows(rim, n)
    return ((diags((parts != CAP).astype(np.float64)) + lid) @ wall).tocsr()


def _find_plane(x: Floats, rim: Ints) -> tuple[Floats, Floats]:
    """The plane's normal (3,), upward, and every vertex' height [mm] above it, shape (n,)."""
    middle = x[rim].mean(axis=0)
    normal = np.linalg.svd(x[rim] - middle)[2][2]
    normal = normal if normal[1] > 0.0 else -normal
    height = (x - middle) @ normal
    return normal, height - min(height[rim].max() + ABOVE, MOST)
