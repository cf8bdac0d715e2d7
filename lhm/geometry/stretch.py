"""How far the triangles of a surface are stretched when it moves."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints

TORN = 5.0
"""Skin stretched so many times its length stretches as a membrane between parts that move apart."""


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
