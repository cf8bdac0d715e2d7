"""Matches of points with a skin: the closest point that faces the same way, and which of these are to be believed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.geometry.bvh import TriangleTree
from ..base.mesh import Floats, Ints, Surface

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
        outward = _unit(np.einsum("kc,kcd->kd", shares, self.normals[corners]))
        away = points - (shares[:, :, None] * self.skin.vertices[corners]).sum(axis=1)
        over = np.abs(np.einsum("kd,kd->k", away, outward)) >= FACING * np.linalg.norm(away, axis=1)
        open_edge = (shares == 0).any(axis=1) & (self.rim[corners] | (shares == 0)).all(axis=1)
        return corners, shares, (triangle >= 0) & ~open_edge & (over | (distance < SHARP) | (turned > 0))


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
