"""How dark the hidden parts of a head are drawn: else the inside of a mouth or socket would look like skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..lhm.geometry.bvh import TriangleTree
from ..lhm.geometry.rays import first_hits
from ..lhm.mesh import Floats, Surface

SKIN, INSIDE = "#d8a48f", "#4a211f"
RAYS, REACH, OFF = 16, 200.0, 0.05
"""Directions tried at each vertex; how far [mm] they look, and how far off the surface they begin."""
DARK, LIGHT = 0.0, 0.2
"""Shares of the sky that a vertex sees: from the first down it is drawn as hidden, from the second up as skin."""


def sky_seen(surface: Surface) -> Floats:
    """The share (n,) of the directions before each vertex, by their cosine, that meet nothing within 200 mm."""
    # Fibonacci's points on a disc, lifted to the hemisphere: evenly spread by cosine (Malley's method).
    k = np.arange(RAYS) + 0.5
    radius, angle = np.sqrt(k / RAYS), np.pi * (1 + 5**0.5) * k
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
    normals = surface.vertex_normals
    aside = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normals, aside)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-30)
    frames = np.stack([first, np.cross(normals, first), normals], axis=1)
    directions = np.einsum("kc,ncd->nkd", local, frames).reshape(-1, 3)
    origins = np.repeat(surface.vertices + OFF * normals, RAYS, axis=0)
    hit = first_hits(TriangleTree(surface.vertices, surface.triangles), origins, directions, REACH)[0]
    return (hit < 0).reshape(-1, RAYS).mean(axis=1)


def shades(surface: Surface) -> NDArray[np.uint8]:
    """Colours (n, 3) of a skin at rest: SKIN where it sees the sky, INSIDE where it does not."""
    seen = np.clip((sky_seen(surface) - DARK) / (LIGHT - DARK), 0.0, 1.0)[:, None]
    light, dark = (np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)], dtype=float) for text in (SKIN, INSIDE))
    return np.round(seen * light + (1 - seen) * dark).astype(np.uint8)
