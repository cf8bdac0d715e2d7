"""Identity directions under which upper and lower lip keep their distance."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ..base.mesh import Floats, Ints
from .space import MOUTH, OUTSIDE

REACH = 6.0
WIDTH = 5.0


def lips_together(mean: Floats, triangles: Ints, parts: Ints, directions: Floats) -> Floats:
    """The directions (k, n, 3) [mm], averaged near the lips' rim over both lips alike.

    A linear model of neutral heads knows no contact: the lips of `mean` (n, 3) [mm] are half a millimetre apart, and
    a direction that thickens or squeezes them lets them cross. Within some 6 mm of the rim a direction is replaced by
    its mean over 5 mm, so that facing points of the two lips move together; farther away it stays as it is.
    """
    mixed = triangles[(parts[triangles] == MOUTH).any(axis=1)]
    rim = np.unique(mixed[parts[mixed] == OUTSIDE])
    share = np.exp(-((cKDTree(mean[rim]).query(mean)[0] / REACH) ** 2))
    near = np.flatnonzero(share > 0.01)
    tree = cKDTree(mean)
    table = cKDTree(mean[near]).sparse_distance_matrix(tree, 2.5 * WIDTH, output_type="ndarray")
    shape = (len(near), len(mean))
    weights = csr_matrix((np.exp(-((table["v"] / WIDTH) ** 2)), (table["i"], table["j"])), shape=shape)
    total = np.asarray(weights.sum(axis=1)).ravel()
    moved = directions.copy()
    for direction in moved:
        average = (weights @ direction) / total[:, None]
        direction[near] += share[near, None] * (average - direction[near])
    return moved
