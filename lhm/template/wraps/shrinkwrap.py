"""Shrink a sphere onto a closed skin with an open mouth (SoftDECA 3.1.1: wraps by shrinking a sphere)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.geometry.distance import SignedDistance
from ...base.geometry.mirror import find_twins, symmetrise
from ...base.geometry.surfaces import geodesic_sphere
from ...base.geometry.topology import neighbours, subdivide
from ...base.mesh import Floats, Surface
from ...base.progress import OnProgress, silent

CLEARANCE = 0.3  # [mm] the wrap ends this far outside of the skin
COARSE = 11
STEPS = (500, 260, 160)
"""How often a wrap of each level is moved; the sphere of frequency COARSE is the first, and each splits the last."""


def concentrate(sphere: Floats, towards: Floats, factor: float) -> Floats:
    """Unit vectors moved by the Möbius map that shrinks lengths near the direction `towards` by `factor`."""
    towards = towards / np.linalg.norm(towards)
    height = sphere @ towards
    lateral = sphere - height[:, None] * towards
    # Stereographic projection from the opposite pole scales `lateral / (1 + height)`.
    plane = lateral / np.maximum(1 + height, 1e-12)[:, None] / factor
    r2 = np.einsum("kd,kd->k", plane, plane)
    moved = (2 * plane + (1 - r2)[:, None] * towards) / (1 + r2)[:, None]
    return np.where(height[:, None] < -1 + 1e-9, sphere, moved)


def shrink(
    skin: Surface,
    spacing: Floats,
    pockets: NDArray[np.bool_],
    focus: Floats,
    *,
    level: int,
    concentration: float = 2.0,
    progress: OnProgress = silent,
) -> Surface:
    """A sphere of 1,212, 4,842 or 19,362 vertices (`level` 1, 2, 3) shrunk onto a closed skin, into its pockets [mm].

    `spacing` (skin vertices): wanted length of the wrap's edges there, relative; `pockets`: mask of those in
    and around pockets; `focus` (3,): the point [mm] towards which the sphere's vertices are
    concentrated from the start. The wrap of a skin that is its own mirror image is its own, too.
    """
    is_symmetric = find_twins(skin.vertices) is not None
    low, high = skin.vertices.min(axis=0), skin.vertices.max(axis=0)
    centre, radii = 0.5 * (low + high), 0.5 * (high - low)
    sphere, triangles = geodesic_sphere(COARSE)
    x = centre + 1.45 * radii * concentrate(sphere, (focus - centre) / radii, concentration)
    distance = SignedDistance(skin)
    cost = [steps * 4**number for number, steps in enumerate(STEPS[:level])]
    for number, steps in enumerate(STEPS[:level]):
        if number:
            x, triangles = subdivide(x, triangles)
        ones = neighbours(triangles, len(x))
        twins = find_twins(x) if is_symmetric else None
        for step in range(steps):
            x = symmetrise(_step(x, triangles, ones, distance, spacing, pockets), twins)
            if step % 20 == 0:
                progress("wrapping the skin", (sum(cost[:number]) + cost[number] * step / steps) / sum(cost))
    return Surface(x, triangles)


def _step(x, triangles, ones, distance, spacing, pockets):
    normals = Surface(x, triangles).vertex_normals
    phi, direction, triangle, weights = distance(x)
    corners = distance.tree.triangles[triangle]
    stiffness = 1.0 / np.einsum("kc,kc->k", weights, spacing[corners])
    total = stiffness * np.asarray(ones.sum(axis=1)).ravel() + ones @ stiffness
    pulled = stiffness[:, None] * (ones @ x) + ones @ (stiffness[:, None] * x)
    umbrella = pulled / total[:, None] - x
    along = np.einsum("kd,kd->k", umbrella, normals)[:, None] * normals
    # The wrap's own normal leads into pockets, away from the closest wall; elsewhere that would be a fold.
    led = pockets[corners].any(axis=1) | (np.einsum("kd,kd->k", normals, direction) > -0.2)
    near = np.where(led, np.exp(-np.abs(phi) / 3.0), 1.0)[:, None]
    outward = near * direction + (1 - near) * normals
    smooth = np.clip(along, -10.0, 10.0)
    return x + 0.6 * (umbrella - along) + 0.03 * smooth - 0.7 * np.clip(phi - CLEARANCE, -2.0, 2.0)[:, None] * outward
