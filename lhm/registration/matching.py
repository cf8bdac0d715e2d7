"""Matches of points with a skin: the closest point that faces the same way, and which of these are to be believed."""

from __future__ import annotations

import numpy as np

from ..geometry.bvh import TriangleTree
from ..mesh import Floats, Ints, Surface

FACING = np.cos(np.radians(60.0))
SHARP = 1.0  # [mm] closer than this a match counts whatever the direction towards it


class Target:
    """A skin that points are matched with; it may be open and of any topology."""

    def __init__(self, skin: Surface):
        self.skin = skin
        self.normals = skin.vertex_normals
        self.faces = _unit(self.normals[skin.triangles].sum(axis=1))
        self.tree = TriangleTree(skin.vertices, skin.triangles)
        self.rim = np.zeros(len(skin.vertices), dtype=bool)
        self.rim[open_edges(skin.triangles).ravel()] = True

    def match(self, points: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
        """The closest points (k, 3) [mm] that face as `normals` (k, 3) do within 60°, their distance, their weight.

        The weight is 0 where there is none, where it lies on an open edge of the skin, and where it lies beside the
        point, more than 60° off the skin's normal, as at the brink of a cut; else 1.
        """
        triangle, weights, distance = self.tree.closest_facing(points, normals, self.faces, FACING)
        corners = self.skin.triangles[triangle]
        closest: Floats = (weights[:, :, None] * self.skin.vertices[corners]).sum(axis=1)
        outward = _unit(np.einsum("kc,kcd->kd", weights, self.normals[corners]))
        away = points - closest
        over = np.abs(np.einsum("kd,kd->k", away, outward)) >= FACING * np.linalg.norm(away, axis=1)
        open_edge = (weights == 0).any(axis=1) & (self.rim[corners] | (weights == 0)).all(axis=1)
        good = (triangle >= 0) & ~open_edge & (over | (distance < SHARP))
        closest[~good], distance[~good] = points[~good], 0.0
        return closest, distance, good.astype(np.float64)


def robust(distance: Floats, limit: float) -> Floats:
    """Tukey's biweight of distances [mm]: 1 at zero, 0 from `limit` on."""
    inside = np.maximum(1 - (distance / limit) ** 2, 0.0)
    return inside * inside


def open_edges(triangles: Ints) -> Ints:
    """The edges that have one triangle, shape (k, 2)."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return unique[count == 1]


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
