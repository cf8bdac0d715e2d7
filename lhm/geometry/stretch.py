"""How far the triangles of a surface are stretched, and its edges folded, when it moves."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints

TORN = 5.0
"""Skin stretched so many times its length stretches as a membrane between parts that move apart."""
FOLDED, FLAT = 110.0, 60.0
"""[degrees] between the normals on both sides of an edge: folded beyond the one, where it was below the other."""


def greatest_stretches(rest: Floats, moved: Floats, triangles: Ints) -> Floats:
    """The larger principal stretch (m,) of each triangle from `rest` to `moved` [mm], both (n, 3)."""
    a, b = ((x[triangles[:, 1:]] - x[triangles[:, :1]]) for x in (rest, moved))
    length = np.maximum(np.linalg.norm(a[:, 0], axis=1), 1e-12)
    along = a[:, 0] / length[:, None]
    shear = np.einsum("md,md->m", a[:, 1], along)
    height = np.maximum(np.linalg.norm(a[:, 1] - shear[:, None] * along, axis=1), 1e-12)
    first = b[:, 0] / length[:, None]
    second = (b[:, 1] - shear[:, None] * first) / height[:, None]
    p, q, r = (np.einsum("md,md->m", u, v) for u, v in ((first, first), (second, second), (first, second)))
    return np.sqrt(0.5 * (p + q) + np.sqrt((0.5 * (p - q)) ** 2 + r**2))


def torn_area(rest: Floats, moved: Floats, triangles: Ints) -> float:
    """The area [mm²], as moved, of the triangles that are stretched more than five times."""
    a, b, c = (moved[triangles[:, k]] for k in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(areas[greatest_stretches(rest, moved, triangles) > TORN].sum())


def folded_length(rest: Floats, moved: Floats, triangles: Ints) -> float:
    """The length [mm], as moved, of the edges that fold sharply: from less than 60 to more than 110 degrees."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    same = np.flatnonzero((edges[order[1:]] == edges[order[:-1]]).all(axis=1))
    ends, a, b = edges[order[same]], order[same] // 3, order[same + 1] // 3
    before, after = (_angles(x, triangles, a, b) for x in (rest, moved))
    length = np.linalg.norm(moved[ends[:, 0]] - moved[ends[:, 1]], axis=1)
    return float(length[(after > FOLDED) & (before < FLAT)].sum())


def _angles(x: Floats, triangles: Ints, a: Ints, b: Ints) -> Floats:
    """The angle [degrees] between the normals of triangles a (k,) and b (k,)."""
    corners = x[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.degrees(np.arccos(np.clip((normals[a] * normals[b]).sum(axis=1), -1.0, 1.0)))
