"""The simulator's offset and responses of one head: the exact part of a bound rig, and a rig of any head by itself."""

from __future__ import annotations

import numpy as np

from ..lhm.base.mesh import Floats32
from ..lhm.head import LayeredHead
from ..reference import Parameters
from ..reference.face.derivatives import differentiate_head


def derivatives(head: LayeredHead, parameters: Parameters, shapes: Floats32) -> tuple[Floats32, Floats32]:
    """T - S at w = 0, shape (n, 3), and its derivatives by shapes (k, n, 3), all [mm]; some seconds.

    InputError for a face that does not settle under these parameters, and what the simulator raises.
    """
    linear = differentiate_head(head, parameters)
    deltas = shapes.astype(np.float64)
    offset = (linear.offset + linear.face.displacement).astype(np.float32)
    return offset, (linear.skin_by_shapes(deltas) - deltas).astype(np.float32)
