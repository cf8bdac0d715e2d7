"""Loop's subdivision: triangles split into four, and every vertex a weighted mean of those around it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, identity, vstack

from ..mesh import Ints
from .topology import SIDES, midpoints, split_triangles


def subdivide_smoothly(triangles: Ints, n: int) -> tuple[csr_matrix, Ints]:
    """Split triangles over n vertices into four; return weights (n + edges, n), rows of sum one, and the triangles.

    The old vertices come first. Weights are Loop's (1987), with Warren's for the old vertices. Vertices of open edges
    stay, and such an edge has its new vertex in its middle.
    """
    finer, edges = split_triangles(triangles, n)
    count = len(edges)
    _, number = midpoints(triangles, SIDES, n)
    faces = np.bincount(number.ravel(), minlength=count)
    # Corner k + 2 lies across from edge k.
    across = csr_matrix(
        (np.ones(3 * len(triangles)), (number.ravel(), np.roll(triangles, 1, axis=1).ravel())), (count, n)
    )
    ends = csr_matrix((np.ones(2 * count), (np.repeat(np.arange(count), 2), edges.ravel())), (count, n))
    inner = faces == 2
    middles = diags(np.where(inner, 3 / 8, 1 / 2)) @ ends + diags(np.where(inner, 1 / 8, 0.0)) @ across

    around = csr_matrix((np.ones(count), edges.T), (n, n))
    around = around + around.T
    valence = np.asarray(around.sum(axis=1)).ravel()
    share = np.where(valence == 3, 9 / 16, 3 / 8)
    share[valence == 0] = 0.0
    share[np.unique(edges[~inner])] = 0.0
    kept = diags(1.0 - share) @ identity(n) + diags(share / np.maximum(valence, 1.0)) @ around
    return vstack([kept, middles]).tocsr(), finer
