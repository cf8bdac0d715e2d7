"""Many rigid starts at once, laid upon a surface's points and normals and sorted by how well they fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..base.mesh import Floats, Surface
from ..registration.start import Similarity

POINTS = 4000
TURNED = 25.0
"""[mm] What a unit of difference between normals counts as beside a distance."""
FAR, LEAST, MOST = 30.0, 0.4, 2.5


@dataclass(frozen=True, eq=False)
class Sieve:
    """Points (n, 3) [mm] of a surface and normals, evenly chosen by area, in a tree over both."""

    points: Floats
    tree: cKDTree

    @classmethod
    def of(cls, skin: Surface) -> Sieve:
        """Up to POINTS of the surface's triangles, by their centres."""
        along = np.cumsum(skin.areas)
        chosen = np.unique(np.searchsorted(along, (np.arange(POINTS) + 0.5) / POINTS * along[-1]))
        chosen = np.minimum(chosen, len(along) - 1)
        normals = skin.face_normals[chosen]
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        points = skin.vertices[skin.triangles[chosen]].mean(axis=1)
        return cls(points, cKDTree(np.hstack([points, TURNED * normals])))

    def best(
        self, starts: Sequence[Similarity], points: Floats, normals: Floats, kept: int, steps: int
    ) -> list[Similarity]:
        """The `kept` best of `starts` after so many steps each; `points` (k, 3) [mm] and `normals` are laid."""
        scale = np.array([start.scale for start in starts])
        turn = np.array([start.rotation for start in starts])
        shift = np.array([start.shift for start in starts])
        for step in range(steps + 1):
            moved = scale[:, None, None] * np.einsum("sij,kj->ski", turn, points) + shift[:, None]
            turned = np.einsum("sij,kj->ski", turn, normals)
            query = np.concatenate([moved, TURNED * turned], axis=2).reshape(-1, 6)
            distance, nearest = self.tree.query(query)
            distance = distance.reshape(len(starts), -1)
            if step == steps:
                break
            weight = 1.0 / (1.0 + (distance / 10.0) ** 2)
            scale, turn, shift = _fits(points, self.points[nearest].reshape(moved.shape), weight, scale)
        off = np.minimum(distance, FAR).mean(axis=1) / scale
        off[(scale <= LEAST * 1.001) | (scale >= MOST * 0.999)] = np.inf
        order = np.argsort(off, kind="stable")[:kept]
        return [Similarity(float(scale[k]), turn[k], shift[k]) for k in order]


def _fits(points: Floats, goals: Floats, weight: Floats, before: Floats) -> tuple[Floats, Floats, Floats]:
    """Weighted similarities from points (k, 3) to goals (s, k, 3), as in `start.similarity`, for all s at once."""
    share = weight / weight.sum(axis=1, keepdims=True)
    a = points[None] - (share @ points)[:, None]
    middle = np.einsum("sk,skd->sd", share, goals)
    b = goals - middle[:, None]
    u, _, v = np.linalg.svd(np.einsum("sk,ski,skj->sij", share, b, a))
    flip = np.ones((len(goals), 3))
    flip[:, 2] = np.sign(np.linalg.det(u @ v))
    turn = (u * flip[:, None]) @ v
    size = np.einsum("sk,ski,sij,skj->s", share, b, turn, a) / np.einsum("sk,skd->s", share, a**2)
    scale = np.clip(size, np.maximum(LEAST, 0.8 * before), np.minimum(MOST, 1.25 * before))
    return scale, turn, middle - scale[:, None] * np.einsum("sij,sj->si", turn, share @ points)
