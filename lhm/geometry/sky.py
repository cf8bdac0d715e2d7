"""How much of the sky a surface sees from each of its points: little within a mouth, a nostril or an ear's folds."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Surface
from .bvh import TriangleTree
from .rays import first_hits

RAYS, REACH, OFF = 16, 200.0, 0.05
"""Directions tried at each point; how far [mm] they look, and how far off the surface they begin."""


def sky_seen(surface: Surface, points: Floats | None = None, normals: Floats | None = None) -> Floats:
    """The share (k,) of the directions before each point, by their cosine, that meet nothing within 200 mm.

    `points` on the surface [mm] and their unit normals, shape (k, 3); by default its vertices.
    """
    points = surface.vertices if points is None else points
    normals = surface.vertex_normals if normals is None else normals
    # Fibonacci's points on a disc, lifted to the hemisphere: evenly spread by cosine (Malley's method).
    k = np.arange(RAYS) + 0.5
    radius, angle = np.sqrt(k / RAYS), np.pi * (1 + 5**0.5) * k
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
    aside = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normals, aside)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-30)
    frames = np.stack([first, np.cross(normals, first), normals], axis=1)
    directions = np.einsum("kc,ncd->nkd", local, frames).reshape(-1, 3)
    origins = np.repeat(points + OFF * normals, RAYS, axis=0)
    hit = first_hits(TriangleTree(surface.vertices, surface.triangles), origins, directions, REACH)[0]
    return (hit < 0).reshape(-1, RAYS).mean(axis=1)
