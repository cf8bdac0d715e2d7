"""Signed distance to a closed surface."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints, Surface
from .bvh import TriangleTree
from .topology import across_edges


class SignedDistance:
    """Distance to a closed surface, positive outside, with the sign of the closest feature's pseudonormal.

    Normals are the face's inside a triangle, the two faces' sum on an edge and weighted by angle at a vertex, which
    is what makes the sign right everywhere (Baerentzen and Aanaes, IEEE TVCG 11(3), 2005).
    """

    def __init__(self, surface: Surface):
        self.tree = TriangleTree(surface.vertices, surface.triangles)
        faces = surface.face_normals
        self._faces = faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-30)
        self._edges = self._faces[:, None] + self._faces[across_edges(surface.triangles)]
        self._vertices = _angle_weighted(surface, self._faces)

    def __call__(self, points: Floats) -> tuple[Floats, Floats, Ints, Floats]:
        """Return distance (k,) [mm], outward unit direction (k, 3), triangle (k,) and barycentric weights (k, 3)."""
        triangle, weights, distance = self.tree.closest(points)
        corners = self.tree.triangles[triangle]
        zero = weights == 0.0
        normal = self._faces[triangle]
        on_edge, on_vertex = zero.sum(axis=1) == 1, zero.sum(axis=1) == 2
        # Edge k runs from corner k to k + 1; the point is on it if the weight of corner k + 2 vanishes.
        normal[on_edge] = self._edges[triangle[on_edge], (zero[on_edge].argmax(axis=1) + 1) % 3]
        normal[on_vertex] = self._vertices[corners[on_vertex, weights[on_vertex].argmax(axis=1)]]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        away = points - np.einsum("kc,kcd->kd", weights, self.tree.vertices[corners])
        side = np.where(np.einsum("kd,kd->k", away, normal) >= 0, 1.0, -1.0)
        far = distance[:, None] > 1e-6
        direction = np.divide(side[:, None] * away, distance[:, None], out=normal, where=far)
        return side * distance, direction, triangle, weights


def _angle_weighted(surface: Surface, faces: Floats) -> Floats:
    x = surface.vertices[surface.triangles]
    normals = np.zeros_like(surface.vertices)
    for k in range(3):
        a, b = x[:, (k + 1) % 3] - x[:, k], x[:, (k + 2) % 3] - x[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("kd,kd->k", a, b))
        np.add.at(normals, surface.triangles[:, k], angle[:, None] * faces)
    return normals
