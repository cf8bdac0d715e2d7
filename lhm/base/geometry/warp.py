"""Maps of space: the rigid motion and the similarity that fit points best, and a warp of scattered displacements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial.distance import cdist

from ..mesh import Floats, Ints


def rigid_motion(rest: Floats, moved: Floats) -> tuple[Floats, Floats]:
    """Fit rotation R (3, 3) and translation t [mm] of moved = R rest + t, (n, 3), by least squares (Kabsch 1976)."""
    a, b = rest.mean(axis=0), moved.mean(axis=0)
    u, _, vt = np.linalg.svd((moved - b).T @ (rest - a))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation, b - rotation @ a


@dataclass(frozen=True)
class Similarity:
    """x -> scale rotation x + shift [mm]."""

    scale: float
    rotation: Floats
    shift: Floats

    def __call__(self, points: Floats) -> Floats:
        """Move points (n, 3) [mm]."""
        return self.scale * points @ self.rotation.T + self.shift


def fit_similarity(rest: Floats, moved: Floats, weight: Floats | None = None) -> Similarity:
    """Fit moved = s R rest + t to points (n, 3), weighted (n,), by least squares (Umeyama, TPAMI 13(4), 1991)."""
    w = np.ones((len(rest), 1)) if weight is None else (weight / weight.mean())[:, None]
    middle, goal = (w * rest).mean(axis=0), (w * moved).mean(axis=0)
    a, b = rest - middle, w * (moved - goal)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    scale = float(np.einsum("nd,nd->", b, a @ rotation.T) / max(np.einsum("nd,nd->", w * a, a), 1e-30))
    return Similarity(scale, rotation, goal - scale * rotation @ middle)


def farthest_points(points: Floats, count: int, first: Ints) -> Ints:
    """Return indices of `first` and of points farthest from all chosen before, `count` in all or every point."""
    chosen = list(first)
    distance = np.full(len(points), np.inf)
    for index in chosen:
        distance = np.minimum(distance, np.linalg.norm(points - points[index], axis=1))
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


class TriharmonicWarp:
    """u(x) = sum_j c_j |x - x_j|³ + affine, with the given displacements at its centres: SoftDECA Eq. 3.

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
        """Return the matrix that takes coefficients to displacements at `points` [mm], shape (k, n + 4)."""
        y = (points - self.origin) / self.scale
        return np.hstack([cdist(y, self.centres) ** 3, np.ones((len(y), 1)), y])

    def coefficients(self, displacements: Floats) -> Floats:
        """Return coefficients (n + 4, 3) of the warp with these displacements [mm] at the centres, shape (n, 3)."""
        return lu_solve(self._factor, np.vstack([displacements, np.zeros((4, 3))]))
