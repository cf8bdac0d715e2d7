"""A smooth warp of space from displacements at scattered centres (SoftDECA Eq. 3)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial.distance import cdist

from ..mesh import Floats, Ints


def farthest_points(points: Floats, count: int, first: Ints) -> Ints:
    """Indices of `first` and of points farthest from all chosen before, `count` in all."""
    chosen = list(first)
    distance = np.full(len(points), np.inf)
    for index in chosen:
        distance = np.minimum(distance, np.linalg.norm(points - points[index], axis=1))
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


class TriharmonicWarp:
    """u(x) = sum_j c_j |x - x_j|³ + affine, with the given displacements at its centres; factorised once.

    Lengths are scaled to the centres' extent, which keeps the system well conditioned.
    """

    def __init__(self, centres: Floats):
        self.origin = centres.mean(axis=0)
        self.scale = float(np.ptp(centres, axis=0).max())
        self.centres = (centres - self.origin) / self.scale
        n = len(centres)
        affine = np.column_stack([np.ones(n), self.centres])
        system = np.zeros((n + 4, n + 4))
        system[:n, :n] = cdist(self.centres, self.centres) ** 3
        system[:n, n:], system[n:, :n] = affine, affine.T
        self._factor = lu_factor(system)

    def basis(self, points: Floats) -> Floats:
        """The matrix that takes coefficients to displacements at `points` [mm], shape (k, n + 4)."""
        y = (points - self.origin) / self.scale
        return np.hstack([cdist(y, self.centres) ** 3, np.ones((len(y), 1)), y])

    def coefficients(self, displacements: Floats) -> Floats:
        """Coefficients (n + 4, 3) of the warp with these displacements [mm] at the centres, shape (n, 3)."""
        return lu_solve(self._factor, np.vstack([displacements, np.zeros((4, 3))]))
