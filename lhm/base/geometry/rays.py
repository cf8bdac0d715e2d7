"""Where rays first meet the triangles of a tree, and how much of the sky a surface sees. Compiled."""

from __future__ import annotations

import numpy as np

from ..kernels import njit
from ..mesh import Floats, Ints, Surface
from .bvh import TriangleTree

EDGE = 1e-9
"""Share of a triangle by which a ray may pass beyond its edge, so that none slips between two neighbours."""


@njit(cache=True)
def _enters(box, origin, direction, most):
    """Return the parameter at which a ray enters a box, or infinity if it does not before `most`."""
    low, high = 0.0, most
    for c in range(3):
        if direction[c] == 0.0:
            if origin[c] < box[c] or origin[c] > box[3 + c]:
                return np.inf
            continue
        a, b = (box[c] - origin[c]) / direction[c], (box[3 + c] - origin[c]) / direction[c]
        low, high = max(low, min(a, b)), min(high, max(a, b))
    return low if low <= high else np.inf


@njit(cache=True)
def _meets(origin, direction, corners):
    """Return the parameter at which a ray meets a triangle (3, 3), or infinity (Moeller and Trumbore 1997)."""
    e1, e2 = corners[1] - corners[0], corners[2] - corners[0]
    h = np.cross(direction, e2)
    det = np.dot(e1, h)
    if det == 0.0:
        return np.inf
    s = origin - corners[0]
    u = np.dot(s, h) / det
    k = np.cross(s, e1)
    v = np.dot(direction, k) / det
    t = np.dot(e2, k) / det
    return t if u >= -EDGE and v >= -EDGE and u + v <= 1 + EDGE and t >= 0.0 else np.inf


@njit(cache=True)
def _first(origins, directions, reach, corners, order, start, stop, left, box):
    n = len(origins)
    which, distance = np.full(n, -1), np.full(n, np.inf)
    stack = np.empty(128, np.int64)
    for i in range(n):
        origin, direction, best = origins[i], directions[i], reach
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            node = stack[size]
            if _enters(box[node], origin, direction, best) == np.inf:
                continue
            if left[node] >= 0:
                stack[size], stack[size + 1] = left[node], left[node] + 1
                size += 2
                continue
            for k in range(start[node], stop[node]):
                t = _meets(origin, direction, corners[order[k]])
                if t <= best:
                    best, which[i], distance[i] = t, order[k], t
    return which, distance


def first_hits(tree: TriangleTree, origins: Floats, directions: Floats, reach: float) -> tuple[Ints, Floats]:
    """Return the triangle (k,) that each ray meets first, from either side, and the way there (k,) in `directions`.

    Triangle -1 and an infinite way for a ray that meets none within `reach`.
    """
    rays = (np.ascontiguousarray(values, dtype=np.float64) for values in (origins, directions))
    return _first(*rays, float(reach), tree.corners, *tree.nodes)


RAYS, REACH, OFF = 16, 200.0, 0.05
"""Directions tried at each point; how far [mm] they look, and how far off the surface they begin."""


def visible_sky(surface: Surface) -> Floats:
    """Return the share (n,) of the directions before each vertex, by their cosine, that meet nothing within 200 mm."""
    points, normals = surface.vertices, surface.vertex_normals
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
