"""The surrogate under the effects: what it makes of a face whose parameters are the simulator's, per triangle."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from ..lhm import expressions
from ..lhm.base.mesh import Floats
from ..lhm.head import LayeredHead
from ..lhm.identities.space import LinearSpace
from ..reference import Parameters
from ..surrogate import Surrogate
from ..surrogate.local import around_vertices
from .effect_cases import Effect


def surrogate_skin(space: LinearSpace, code: Floats, head: LayeredHead, effect: Effect) -> Floats | None:
    """The shipped network's skin [mm] (n, 3) of an effect's expression; None for people that it does not know.

    Parameters beyond what it has seen are taken at the nearest that it has.
    """
    network = Surrogate.load()
    if network.space != space.name:
        return None
    rig = network.bind(head.skin, code, on_skin(effect.with_it(head), head), beyond="clamp")
    return rig.frame(expressions.weights_of(dict(effect.expression))).astype(np.float64)


def on_skin(parameters: Parameters, head: LayeredHead) -> Parameters:
    """The same parameters with local values per face of the skin in place of triangles of the wraps."""
    moved = {}
    for field in fields(parameters):
        value = np.asarray(getattr(parameters, field.name))
        if value.shape == (len(head.skin_wrap.triangles),):
            # Skin off the wrap's triangles is beyond their corners, and must not leave the values' range.
            there = np.clip(head.skin_from_wrap @ around_vertices(value, head.skin_wrap), value.min(), value.max())
            moved[field.name] = there[head.skin.triangles].mean(axis=1)
    return replace(parameters, **moved)
