"""Where the template stands before it is deformed: rotation, translation and scale."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ..base.geometry.warp import rigid_motion
from ..base.mesh import Floats
from .matching import Target, robust

PITCHES, HEIGHTS, SCALES = (-15.0, 0.0, 15.0), (-25.0, 0.0, 25.0), (0.9, 1.0, 1.1)
FEW, COARSE_STEPS, FINE_STEPS = 250, 15, 40
CAP = 10.0
"""[mm] Farther matches count as this far in a start's score."""


@dataclass(frozen=True)
class Similarity:
    """x -> scale rotation x + shift [mm]."""

    scale: float
    rotation: Floats
    shift: Floats

    def __call__(self, points: Floats) -> Floats:
        """The moved points (n, 3) [mm]."""
        return self.scale * points @ self.rotation.T + self.shift


def similarity(rest: Floats, moved: Floats) -> Similarity:
    """The least-squares fit moved = s R rest + t of points (n, 3) (Umeyama, IEEE TPAMI 13(4), 1991, Eq. 39-42)."""
    rotation, _ = rigid_motion(rest, moved)
    a, b = rest - rest.mean(axis=0), moved - moved.mean(axis=0)
    scale = float(np.einsum("nd,nd->", b, a @ rotation.T) / max(np.einsum("nd,nd->", a, a), 1e-30))
    return Similarity(scale, rotation, moved.mean(axis=0) - scale * rotation @ rest.mean(axis=0))


def automatic(points: Floats, normals: Floats, target: Target) -> tuple[Similarity, float]:
    """The similarity that lays a template's face on a skin, by ICP from 27 starts, and its score [mm].

    `points` (n, 3) [mm] and their `normals` are the template's face; both look along +z with +y up. Each start puts
    the foremost points of both upon one another, then varies pitch, height and scale. The score is the mean distance
    of the matches, those that fail or are farther than 10 mm counted as 10 mm.
    """
    skin = target.skin.vertices
    tip, goal = points[points[:, 2].argmax()], skin[skin[:, 2].argmax()]
    some = np.unique(np.linspace(0, len(points) - 1, FEW).astype(int))
    found: list[tuple[float, int, Similarity]] = []
    for pitch, height, scale in product(np.radians(PITCHES), HEIGHTS, SCALES):
        c, s = np.cos(pitch), np.sin(pitch)
        rotation = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
        start = Similarity(scale, rotation, goal + [0.0, height, 0.0] - scale * rotation @ tip)
        moved = icp(start, points[some], normals[some], target, COARSE_STEPS)
        found.append((score(moved, points[some], normals[some], target), len(found), moved))
    moved = icp(min(found)[2], points, normals, target, FINE_STEPS)
    return moved, score(moved, points, normals, target)


def icp(start: Similarity, points: Floats, normals: Floats, target: Target, steps: int) -> Similarity:
    """The similarity after so many steps, each a fit to the closest points [mm], those far off left out."""
    limits = np.geomspace(30.0, CAP, steps)
    for limit in limits:
        closest, distance, weight = target.match(start(points), normals @ start.rotation.T, reach=limit)
        used = (weight * robust(distance, limit)) > 0.2
        if used.sum() < 0.25 * len(points):
            break
        start = similarity(points[used], closest[used])
    return start


def score(start: Similarity, points: Floats, normals: Floats, target: Target) -> float:
    """How far the points are off the target on average [mm at the points' own size], 10 mm where there is no match."""
    _, distance, weight = target.match(start(points), normals @ start.rotation.T, reach=CAP)
    return float(np.where(weight > 0, np.minimum(distance, CAP), CAP).mean()) / start.scale
