"""The way from a skin wrap inward to a surface of the anatomy."""

from __future__ import annotations

import numpy as np

from ..base.geometry.bvh import TriangleTree
from ..base.geometry.rays import first_hits
from ..base.mesh import Floats, Surface
from ..wraps.landmarks import Mask

LONGEST = 45.0  # [mm]
OFF_SKIN = 1e-3
"""[mm] by which a ray starts inside the wrap, so that it does not meet the triangles that it starts from."""
GRAZING = 0.2
"""A ray that meets skin or bone at an angle whose sine is less says nothing about the depth there."""


def connectors_to(
    skin_wrap: Surface, normals: Floats, directions: Floats, surface: Surface, *, longest: float = LONGEST
) -> tuple[Floats, Mask]:
    """Connectors (n, 3) [mm] from the vertices of a closed skin wrap to a closed surface inside it, and where found.

    A ray goes along the unit `directions` (n, 3), and where that fails against the outward unit `normals` (n, 3). Found
    is what enters `surface` from outside within `longest` [mm], neither grazing it nor the wrap, and before the ray
    leaves the wrap: not so over the mouth's bag, in eye sockets, ears, or over a neck without bone. NaN elsewhere.
    """
    bone = TriangleTree(surface.vertices, surface.triangles)
    skin = TriangleTree(skin_wrap.vertices, skin_wrap.triangles)
    faces = surface.face_normals
    faces = faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-30)
    connectors = np.full_like(skin_wrap.vertices, np.nan)
    for way in (directions, -normals):
        missing = np.flatnonzero(np.isnan(connectors[:, 0]))
        ray, start = way[missing], skin_wrap.vertices[missing] + OFF_SKIN * way[missing]
        triangle, distance = first_hits(bone, start, ray, longest)
        leaves = first_hits(skin, start, ray, longest)[1]
        enters = -np.einsum("kd,kd->k", faces[triangle], ray) > GRAZING
        inward = -np.einsum("kd,kd->k", normals[missing], ray) > GRAZING
        good = (triangle >= 0) & enters & inward & (distance < leaves)
        connectors[missing[good]] = (distance[good] + OFF_SKIN)[:, None] * ray[good]
    return connectors, ~np.isnan(connectors[:, 0])
