"""Points that mirror each other at a plane x = constant, as the two halves of a face do."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ..mesh import Floats, Ints

TOLERANCE = 0.1
"""[mm]: a point farther from its twin's mirror image makes a face lopsided. Identities keep within .03 mm."""


def find_twins(points: Floats) -> Ints | None:
    """Find the point (n,) that mirrors each of `points` (n, 3) [mm]; one in the plane is its own twin.

    The plane lies midway between the outermost points. None where a point has no twin.
    """
    x = points[:, 0]
    image = points * [-1.0, 1.0, 1.0] + [x.min() + x.max(), 0.0, 0.0]
    off, twins = cKDTree(points).query(image)
    paired = np.array_equal(twins[twins], np.arange(len(points)))
    return twins if paired and off.max() <= TOLERANCE else None


def find_middle(points: Floats, twins: Ints) -> float:
    """Find the plane's x [mm] between points (..., n, 3) and their twins; a few that lean do not move it."""
    x = points[..., 0]
    return float(np.median(0.5 * (x + x[..., twins])))


def mirror_image(points: Floats, twins: Ints) -> Floats:
    """Return where points (..., n, 3) [mm] would lie if each were the mirror image of its twin."""
    return points[..., twins, :] * [-1.0, 1.0, 1.0] + [2.0 * find_middle(points, twins), 0.0, 0.0]


def is_symmetric(points: Floats, twins: Ints) -> bool:
    """Return whether points (..., n, 3) [mm] are their own mirror image."""
    return bool(np.linalg.norm(points - mirror_image(points, twins), axis=-1).max() <= TOLERANCE)


def symmetrise(points: Floats, twins: Ints | None) -> Floats:
    """Return the mean of points (..., n, 3) [mm] and their mirror image; without twins the points."""
    return points if twins is None else 0.5 * (points + mirror_image(points, twins))


def symmetrise_weights(weights: csr_matrix, row_twins: Ints, column_twins: Ints) -> csr_matrix:
    """Return the mean of weights (n, m), from m points to n others, and of what they are on the other side."""
    return (0.5 * (weights + weights[row_twins][:, column_twins])).tocsr()
