"""Parameters that vary over a face, given per face of its skin: at the skin's vertices, and on the wraps of a head."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Surface
from ...lhm.head.head import LayeredHead
from .parameters import Parameters


def average_around(values: Floats, surface: Surface) -> Floats:
    """Average around each vertex (n,) what its triangles have, of values (triangles,)."""
    corners, n = surface.triangles.ravel(), len(surface.vertices)
    sums = np.bincount(corners, weights=np.repeat(values, 3), minlength=n)
    return sums / np.maximum(np.bincount(corners, minlength=n), 1)


def at_vertices(name: str, value: float | Floats, skin: Surface) -> Floats:
    """Return a parameter at a skin's vertices, shape (n,), mapped to [-1, 1]; `value` is one number or one per face.

    The average is one of mapped values: of a stiffness, that is of its logarithm, since ratios of stiffnesses count.
    InputError for another number of values.
    """
    values = np.asarray(value, dtype=np.float64)
    info = Parameters.info(name)
    if values.ndim and values.shape != (len(skin.triangles),):
        raise InputError(f"parameter {name}: expected one value, or one per face, ({len(skin.triangles)},)")
    mapped = info.normalise(values)
    return average_around(mapped, skin) if values.ndim else np.full(len(skin.vertices), float(mapped))


def from_wraps(name: str, value: float | Floats, head: LayeredHead) -> Floats:
    """Return the same of one number, or one per triangle of a head's wraps, at the skin's vertices."""
    values = np.asarray(value, dtype=np.float64)
    if not values.ndim:
        return at_vertices(name, value, head.skin)
    on_wrap = at_vertices(name, value, head.skin_wrap)
    # Skin off the wrap's triangles is beyond their corners, and must not leave the values' range.
    return np.clip(head.skin_from_wrap @ on_wrap, on_wrap.min(), on_wrap.max())


def on_wraps(parameters: Parameters, head: LayeredHead) -> Parameters:
    """Return p with local values per triangle of a head's wraps, as the simulator takes them, of one per face of skin.

    They go by way of the vertices, so that a network, which sees these, sees the same field.
    """
    varying: dict[str, Any] = {}
    for name in (each.name for each in fields(parameters)):
        value = getattr(parameters, name)
        if np.ndim(value):
            on_wrap = head.wrap_from_skin @ at_vertices(name, value, head.skin)
            varying[name] = Parameters.info(name).denormalise(on_wrap[head.skin_wrap.triangles].mean(axis=1))
    return replace(parameters, **varying) if varying else parameters
