"""Parameters that vary over the face, on the tets, triangles and vertices of a head's wraps (SoftDECA 3.5, Eq. 20)."""

from __future__ import annotations

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Surface

TETS_PER_PRISM = 3


def on_triangles(name: str, value: float | Floats, wrap: Surface) -> float | Floats:
    """A parameter per triangle of the wrap; one number stays one. SceneError for another count."""
    if np.ndim(value) and len(value) != len(wrap.triangles):  # type: ignore[arg-type]
        raise SceneError(f"parameter {name}: {len(value)} values for {len(wrap.triangles)} triangles")  # type: ignore[arg-type]
    return value


def on_tets(name: str, value: float | Floats, wrap: Surface) -> float | Floats:
    """A parameter per tet of one layer of prisms, from one number, one per triangle, or one per tet of the layer."""
    if not np.ndim(value):
        return value
    triangles, count = len(wrap.triangles), len(value)  # type: ignore[arg-type]
    if count == triangles:
        return np.repeat(value, TETS_PER_PRISM)
    if count != TETS_PER_PRISM * triangles:
        raise SceneError(
            f"parameter {name}: {count} values for {triangles} triangles, or {TETS_PER_PRISM * triangles} tets"
        )
    return value


def on_vertices(name: str, value: float | Floats, wrap: Surface) -> float | Floats:
    """A parameter per vertex: the mean over the triangles around, weighted by their area."""
    if not np.ndim(value):
        return value
    weight = np.repeat(wrap.areas, 3)
    values = np.repeat(on_triangles(name, value, wrap), 3)
    corners, n = wrap.triangles.ravel(), len(wrap.vertices)
    return np.bincount(corners, weight * values, n) / np.maximum(np.bincount(corners, weight, n), 1e-300)
