"""Parameters that vary over a face, given per face of its skin, on vertices and on the wraps of a head."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Surface
from ..lhm.head import LayeredHead
from ..reference import Parameters
from ..reference.face.parameters import ParameterInfo
from .corpus.mixture import STATIC


def around_vertices(values: Floats, surface: Surface) -> Floats:
    """The mean (n,) of what the triangles around each vertex have, of values (triangles,)."""
    corners, n = surface.triangles.ravel(), len(surface.vertices)
    found = np.bincount(corners, weights=np.repeat(values, 3), minlength=n)
    return found / np.maximum(np.bincount(corners, minlength=n), 1)


def at_vertices(name: str, value: float | Floats, skin: Surface) -> Floats:
    """A parameter at the vertices, shape (n,), of one number or one per face; InputError for what is out of range.

    Stiffnesses are averaged by their logarithm, as all of p is that is spaced by it: their ratios are what counts.
    """
    n, values = len(skin.vertices), np.asarray(value, dtype=np.float64)
    info = Parameters.info(name)
    if values.ndim and values.shape != (len(skin.triangles),):
        raise InputError(f"parameter {name}: expected one value, or one per face of the skin, ({len(skin.triangles)},)")
    outside = ~((values >= info.low) & (values <= info.high))
    if outside.any():
        worst = np.ravel(values)[np.ravel(outside)][0]
        raise InputError(f"parameter {name} = {worst:g} is outside [{info.low:g}, {info.high:g}] {info.unit}")
    if not values.ndim:
        return np.full(n, float(values))
    return info.denormalise(around_vertices(info.normalise(values), skin))


def on_wraps(parameters: Parameters, head: LayeredHead) -> Parameters:
    """The same for a simulation, which has local values per triangle of the wraps."""
    values: dict[str, Any] = {}
    for info in Parameters.infos():
        value = getattr(parameters, info.name)
        if np.ndim(value):
            value = _carry(info, info.normalise(at_vertices(info.name, value, head.skin)), head)
        values[info.name] = value
    return Parameters(**values)


def _carry(info: ParameterInfo, normalised: Floats, head: LayeredHead) -> Floats:
    """A parameter on the wraps' triangles (k,), of one mapped to [-1, 1] at the skin's vertices (n,)."""
    on_triangles = (head.wrap_from_skin @ normalised)[head.skin_wrap.triangles].mean(axis=1)
    return info.denormalise(on_triangles)


def of_static(head: LayeredHead, at_vertices: Floats) -> Parameters:
    """Parameters for a simulation, of STATIC mapped to [-1, 1] at the skin's vertices (n, P): numbers where uniform."""
    values: dict[str, Any] = {}
    for k, name in enumerate(STATIC):
        info, column = Parameters.info(name), at_vertices[:, k]
        if np.ptp(column) < 1e-9 or not info.local:
            values[name] = float(info.denormalise(column[0]))
        else:
            values[name] = _carry(info, column, head)
    return Parameters(**values)
