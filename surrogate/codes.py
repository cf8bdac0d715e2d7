"""The code of a space for a skin in its triangles that did not come from it."""

from __future__ import annotations

import numpy as np

from ..lhm.base.geometry.warp import rigid_motion
from ..lhm.base.mesh import Floats, Surface
from ..lhm.identities.space import CLIP, LinearSpace

RIDGE = 1.0
"""[mm²] of each coefficient of a code that is fitted to a skin, over the mean square distance of vertices."""


def nearest_code(space: LinearSpace, skin: Surface, *, ridge: float = RIDGE) -> Floats:
    """The code whose skin is nearest to one of the space's triangles, up to a rigid motion.

    Least squares with standard normal codes as the prior, by `ridge`, clipped as samples are.
    """
    code = np.zeros(space.code_size)
    basis = space.identity.reshape(space.code_size, -1)
    gram = basis @ basis.T / len(skin.vertices) + ridge * np.eye(len(code))
    for _ in range(5):
        rotation, translation = rigid_motion(skin.vertices, space.skin(code).vertices)
        aligned = skin.vertices @ rotation.T + translation
        right = basis @ (aligned - space.mean.vertices).ravel() / len(skin.vertices)
        code = np.clip(np.linalg.solve(gram, right), -CLIP, CLIP)
    return code
