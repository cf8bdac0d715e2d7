"""Points laid upon a surface by a rigid motion, by their closest points that face alike."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ..mesh import Floats
from .bvh import TriangleTree

STEPS = 50
STILL = 1e-4
"""[mm] A step by which a registration has ended."""
FACING = 0.5
"""Cosine of the angle at most between the normals of a point and of the surface."""


def settle_on(tree: TriangleTree, faces: Floats, points: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Move points (n, 3) [mm] rigidly onto a surface, the farther half of them left out; also their normals then.

    `faces` (m, 3) are unit normals of the surface's triangles, `normals` (n, 3) those of the points. Distances are to
    the planes of the closest triangles, along which points may slide (Chen and Medioni 1992).
    """
    placed, facing = points, normals
    for _ in range(STEPS):
        triangle, weights, distance = tree.closest_facing(placed, facing, faces, FACING)
        found = np.isfinite(distance)
        near = found & (distance <= max(float(np.median(distance[found])) if found.any() else 0.0, 1e-9))
        if np.count_nonzero(near) < 6:
            break
        goal = np.einsum("nk,nkd->nd", weights[near], tree.corners[triangle[near]])
        middle, normal = placed.mean(axis=0), faces[triangle[near]]
        arms = placed[near] - middle
        equations = np.column_stack([np.cross(arms, normal), normal])
        gaps = np.einsum("nd,nd->n", goal - placed[near], normal)
        turn, shift = np.linalg.lstsq(equations, gaps, rcond=None)[0].reshape(2, 3)
        rotation = Rotation.from_rotvec(turn)
        ahead = rotation.apply(placed - middle) + middle + shift
        moved, placed, facing = float(np.abs(ahead - placed).max()), ahead, rotation.apply(facing)
        if moved <= STILL:
            break
    return placed, facing
