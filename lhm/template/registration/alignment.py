"""Where the template stands before it is deformed: matches with a skin, and the similarity that fits them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...base.geometry.bvh import TriangleTree
from ...base.geometry.topology import open_edges
from ...base.geometry.warp import Similarity, fit_similarity
from ...base.mesh import Floats, Ints, Surface, unit

FACING = np.cos(np.radians(60.0))


@dataclass(frozen=True)
class StartPolicy:
    """Constants of the starts that are tried, of their steps and of their score."""

    sharp: float = 1.0  # [mm] closer than this a match counts whatever the direction towards it
    pitches: tuple[float, ...] = (-15.0, 0.0, 15.0)  # [degrees]
    heights: tuple[float, ...] = (-25.0, 0.0, 25.0)  # [mm]
    scales: tuple[float, ...] = (0.9, 1.0, 1.1)
    points: int = 250  # of the face, while starts are compared
    coarse_steps: int = 15  # of every start
    fine_steps: int = 40  # of the best
    farthest: float = 10.0  # [mm] that a match counts in a start's score


POLICY = StartPolicy()
"""The constants as they were measured."""


class Target:
    """A skin that points are matched with; it may be open and of any topology."""

    def __init__(self, skin: Surface):
        self.skin = skin
        self.normals = skin.vertex_normals
        self.faces = unit(self.normals[skin.triangles].sum(axis=1))
        self.tree = TriangleTree(skin.vertices, skin.triangles)
        self.rim = np.zeros(len(skin.vertices), dtype=bool)
        self.rim[open_edges(skin.triangles).ravel()] = True

    def match(
        self, points: Floats, normals: Floats, *, turned: float = 0.0, reach: float = np.inf
    ) -> tuple[Floats, Floats, Floats]:
        """The closest points (k, 3) [mm] that face as `normals` (k, 3) do within 60°, their distance, their weight.

        The weight is 0 where there is none, where it lies on an open edge of the skin, and where it lies beside the
        point, more than 60° off the skin's normal, as at the brink of a cut; else 1. With `turned` [mm], what a unit of
        difference between normals counts, points may lie beside. Beyond `reach` [mm] there may be none.
        """
        corners, shares, good = self.located(points, normals, turned=turned, reach=reach)
        closest: Floats = (shares[:, :, None] * self.skin.vertices[corners]).sum(axis=1)
        closest[~good] = points[~good]
        return closest, np.linalg.norm(points - closest, axis=1), good.astype(np.float64)

    def located(
        self, points: Floats, normals: Floats, *, turned: float = 0.0, reach: float = np.inf
    ) -> tuple[Ints, Floats, NDArray[np.bool_]]:
        """Vertices (k, 3) around such closest points, the barycentric weights, and a mask (k,) of those that count."""
        triangle, shares, distance = self.tree.closest_facing(points, normals, self.faces, FACING, turned, reach)
        corners = self.skin.triangles[triangle]
        outward = unit(np.einsum("kc,kcd->kd", shares, self.normals[corners]))
        away = points - (shares[:, :, None] * self.skin.vertices[corners]).sum(axis=1)
        over = np.abs(np.einsum("kd,kd->k", away, outward)) >= FACING * np.linalg.norm(away, axis=1)
        open_edge = (shares == 0).any(axis=1) & (self.rim[corners] | (shares == 0)).all(axis=1)
        return corners, shares, (triangle >= 0) & ~open_edge & (over | (distance < POLICY.sharp) | (turned > 0))


def tukey_weights(distance: Floats, limit: float) -> Floats:
    """Weigh distances [mm] by Tukey's biweight: 1 at zero, 0 from `limit` on."""
    inside = np.maximum(1 - (distance / limit) ** 2, 0.0)
    return inside * inside


def find_start(points: Floats, normals: Floats, target: Target) -> tuple[Similarity, float]:
    """Find the similarity that lays a template's face on a skin, by ICP from 27 starts, and its score [mm].

    `points` (n, 3) [mm] and their `normals` are the template's face; both look along +z with +y up. Each start puts
    the foremost points of both upon one another, then varies pitch, height and scale. The score is the mean distance
    of the matches, those that fail or are farther than 10 mm counted as 10 mm.
    """
    skin = target.skin.vertices
    tip, goal = points[points[:, 2].argmax()], skin[skin[:, 2].argmax()]
    some = np.unique(np.linspace(0, len(points) - 1, POLICY.points).astype(int))
    fits: list[tuple[float, int, Similarity]] = []
    for pitch, height, scale in product(np.radians(POLICY.pitches), POLICY.heights, POLICY.scales):
        c, s = np.cos(pitch), np.sin(pitch)
        rotation = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
        start = Similarity(scale, rotation, goal + [0.0, height, 0.0] - scale * rotation @ tip)
        motion = icp(start, points[some], normals[some], target, POLICY.coarse_steps)
        fits.append((score_start(motion, points[some], normals[some], target), len(fits), motion))
    motion = icp(min(fits)[2], points, normals, target, POLICY.fine_steps)
    return motion, score_start(motion, points, normals, target)


def icp(start: Similarity, points: Floats, normals: Floats, target: Target, steps: int) -> Similarity:
    """Fit the similarity in so many steps, each to the closest points [mm], those far off left out."""
    limits = np.geomspace(30.0, POLICY.farthest, steps)
    for limit in limits:
        closest, distance, weight = target.match(start(points), normals @ start.rotation.T, reach=limit)
        used = (weight * tukey_weights(distance, limit)) > 0.2
        if used.sum() < 0.25 * len(points):
            break
        start = fit_similarity(points[used], closest[used])
    return start


def score_start(start: Similarity, points: Floats, normals: Floats, target: Target) -> float:
    """Measure how far points are off the target on average [mm at their own size], 10 mm where nothing matches."""
    _, distance, weight = target.match(start(points), normals @ start.rotation.T, reach=POLICY.farthest)
    return float(np.where(weight > 0, np.minimum(distance, POLICY.farthest), POLICY.farthest).mean()) / start.scale
