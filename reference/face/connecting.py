"""Connecting tets: what lies under the skull wrap, skull and eyes, tied to it by well-shaped tets (SoftDECA Eq. 15).

The paper takes the three nearest vertices of a point; three that are adjacent make a better tet (design: method 2.8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints, Surface, as_points, tet_volumes
from ...lhm.head import CRANIUM, FREE, MANDIBLE, LayeredHead

CANDIDATES = 16
FLATTEST = 0.02
"""The least 6 V / h³ of a connecting tet, h the mean edge of its triangle."""
INWARD = 2.0
"""[mm] below the skull wrap where a bone's points are taken if the head has no surface of the skull."""
EYE_RADIUS = 12.0
"""[mm], of an adult's eyeball (axial length 24 mm)."""


@dataclass(frozen=True, eq=False)
class Attached:
    """Points (k, 3) [mm] of one rigid thing under the skull wrap, and the bone that it is part of.

    CRANIUM is held, MANDIBLE moves with the jaw, FREE is a rigid body of its own.
    """

    points: Floats
    bone: int = FREE

    def __post_init__(self):
        object.__setattr__(self, "points", as_points("attached points", self.points))
        if self.bone not in (FREE, CRANIUM, MANDIBLE):
            raise SceneError(f"attached: bone {self.bone!r} is none of {FREE}, {CRANIUM}, {MANDIBLE}")


def connecting_tets(points: Floats, wrap: Surface) -> tuple[Ints, Ints]:
    """The wrap's triangle (k,) for each point (k, 3) [mm], and the tets (k, 4): wrap vertices, then n + the point.

    The nearest triangle whose tet is not flat. Raises SceneError for a point, by index, that lies in the plane of all
    triangles near it.
    """
    corners = wrap.vertices[wrap.triangles]
    edge = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).mean(axis=1)
    near = cKDTree(corners.mean(axis=1)).query(points, k=min(CANDIDATES, len(corners)))[1].reshape(len(points), -1)
    a, b, c = (corners[near, k] for k in range(3))
    away = points[:, None] - a
    flatness = np.einsum("pkd,pkd->pk", np.cross(b - a, c - a), away) / edge[near] ** 3
    sound = np.abs(flatness) >= FLATTEST
    bad = np.flatnonzero(~sound.any(axis=1))
    if bad.size:
        raise SceneError(
            f"attached point {bad[0]}: it lies in the plane of the wrap around it ({bad.size} such points)"
        )
    triangle = near[np.arange(len(points)), np.argmax(sound, axis=1)]
    tets = np.column_stack([wrap.triangles[triangle], len(wrap.vertices) + np.arange(len(points))])
    negative = tet_volumes(np.vstack([wrap.vertices, points]), tets) < 0
    tets[negative] = tets[negative][:, [0, 2, 1, 3]]
    return triangle, tets


def bone_points(head: LayeredHead, *, most: int = 2000) -> tuple[Attached, ...]:
    """Cranium and mandible to attach: points of the head's skull near the wrap, or of the wrap itself, moved inward.

    At most so many points per bone, evenly thinned.
    """
    wrap = head.skull_wrap
    found = []
    for bone in (CRANIUM, MANDIBLE):
        ids = np.flatnonzero(head.bone == bone)
        if not ids.size:
            continue
        points = wrap.vertices[ids] - INWARD * wrap.vertex_normals[ids]
        if head.skull is not None:
            skull = head.skull.vertices
            nearest = cKDTree(wrap.vertices).query(skull)[1]
            points = skull[head.bone[nearest] == bone]
        step = -(-len(points) // most)
        found.append(Attached(points[:: max(step, 1)], bone))
    return tuple(found)


def eyeballs(head: LayeredHead, *, radius: float = EYE_RADIUS) -> tuple[Attached, ...]:
    """Two spheres [mm] that touch the middle of the lids from behind; SceneError for a head without that region."""
    if not np.any(head.regions.get("lids", False)):
        raise SceneError("eyeballs: the head has no region 'lids'")
    lids = head.skin_wrap.vertices[head.regions["lids"]]
    middle = 0.5 * (lids[:, 0].min() + lids[:, 0].max())
    sphere = np.asarray(trimesh.creation.icosphere(1, radius).vertices)
    centres = [lids[side].mean(axis=0) - [0.0, 0.0, radius] for side in (lids[:, 0] > middle, lids[:, 0] <= middle)]
    return tuple(Attached(sphere + centre) for centre in centres)
