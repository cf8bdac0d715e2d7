"""The simulator's offset and responses of one head: the exact part of a bound rig, and a rig of any head by itself."""

from __future__ import annotations

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats32
from ..lhm.head import LayeredHead
from ..reference import Parameters, settled
from ..reference.face.linearised import DIRECT, Linearised, linearised
from ..reference.face.settling import FOR_TARGETS


def linearised_face(head: LayeredHead, parameters: Parameters) -> Linearised:
    """The face under p, settled and linearised; some seconds. InputError for one that does not come to rest."""
    neutral = settled(head, parameters, **FOR_TARGETS)
    if not neutral.converged:
        raise InputError(f"the face does not settle under these parameters ({neutral.reason})")
    return linearised(neutral, accuracy=DIRECT)


def derivatives(head: LayeredHead, parameters: Parameters, shapes: Floats32) -> tuple[Floats32, Floats32]:
    """T - S at w = 0, shape (n, 3), and its derivatives by shapes (k, n, 3), all [mm]; some seconds.

    InputError for a face that does not settle under these parameters, and what the simulator raises.
    """
    linear = linearised_face(head, parameters)
    deltas = shapes.astype(np.float64)
    offset = (linear.offset + linear.face.displacement).astype(np.float32)
    return offset, (linear.of_expressions(deltas) - deltas).astype(np.float32)
