"""The page of a simulated face: its blendshapes, its rigs under p, and the layers beneath, which move along."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..lhm import expressions
from ..lhm.base.mesh import Floats
from ..lhm.head import LayeredHead
from ..reference import Parameters
from ..surrogate.linear import linearised_face
from .page import Layer, Pose, Rig, page

POSES = {
    "jaw open": {"jawOpen": 0.8},
    "smile": {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0},
    "pucker": {"mouthPucker": 1.0},
    "blink": {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    "puffed cheeks": {"cheekPuff": 1.0},
    "brows up": {"browInnerUp": 1.0, "browOuterUpLeft": 1.0, "browOuterUpRight": 1.0},
}
LINEARISED = "simulator, linearised"
LAYERS = (("muscle", (0.66, 0.22, 0.2)), ("skull", (0.92, 0.89, 0.8)))


def face_page(
    title: str,
    words: str,
    head: LayeredHead,
    parameters: Parameters,
    shapes: Floats,
    rigs: Sequence[Rig] = (),
    poses: Sequence[Pose] = (),
) -> str:
    """The page of a head under p, with what the 52 weights add to its skin [mm], shape (52, skin vertices, 3).

    Beside these blendshapes it has the linearised simulator (some seconds), and `rigs`. `poses` replace the usual ones.
    Raises InputError for a face that does not settle, and what the simulator raises.
    """
    linear, n = linearised_face(head, parameters), len(head.bone)
    moved = linear.first_order(np.asarray(shapes, dtype=np.float64))
    simulated = Rig(LINEARISED, linear.face.skin + linear.offset, linear.skin_moved(moved, shapes))
    below = (slice(n * k, n * (k + 1)) for k in (1, 2))
    return page(
        title,
        words,
        head.skin.triangles,
        [Rig("blendshapes", head.skin.vertices, shapes), simulated, *rigs],
        poses=poses or [Pose(name, expressions.weights_of(named)) for name, named in POSES.items()],
        layers=[
            Layer(name, head.skin_wrap.triangles, linear.answer.positions[rows], moved[:, rows], colour)
            for (name, colour), rows in zip(LAYERS, below, strict=True)
        ],
    )
