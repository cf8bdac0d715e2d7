"""The code of a space for a skin in its triangles that did not come from it, and whether both belong together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.errors import InputError
from ..base.geometry.warp import rigid_motion
from ..base.mesh import Floats, Surface
from .space import CLIP, LinearSpace

RIDGE = 1.0
"""[mm²] Penalty of each coefficient of a fitted code, beside the mean square distance of vertices."""
TIGHT = 1e-6
"""[mm²] The same for a skin that is to be met as well as a code can."""
SAME = 0.5
"""[mm] Mean distance within which a skin is that of its code."""


@dataclass(frozen=True, eq=False)
class NearestPerson:
    """The person of a space who is nearest to a skin: the code (c,), and the mean distance of vertices [mm]."""

    code: Floats
    distance: float

    @classmethod
    def from_skin(cls, space: LinearSpace, skin: Surface) -> NearestPerson:
        """Find who is nearest to a skin in the space's triangles, as it lies there."""
        code = nearest_code(space, skin, ridge=TIGHT)
        return cls(code, float(np.linalg.norm(space.skin(code).vertices - skin.vertices, axis=1).mean()))

    @property
    def is_same(self) -> bool:
        """Whether the skin is this person's: an error that was measured on people of the space holds for it."""
        return self.distance <= SAME


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


def check_belonging(space: LinearSpace, code: Floats, skin: Surface) -> None:
    """Raise InputError for a code whose skin is farther from one given than half-way from the nearest to the mean's.

    `nearest_code` keeps well within, also where no code makes the skin; of another person's codes a few in a hundred
    do.
    """

    def away(other: Surface) -> float:
        """Return the mean distance [mm] of vertices after a rigid motion."""
        rotation, translation = rigid_motion(skin.vertices, other.vertices)
        aligned = skin.vertices @ rotation.T + translation
        return float(np.linalg.norm(aligned - other.vertices, axis=1).mean())

    here = away(space.skin(code))
    if here <= SAME:
        return
    nearest = away(space.skin(nearest_code(space, skin)))
    most = max(0.5 * (nearest + away(space.mean)), nearest + SAME)
    if here > most:
        raise InputError(
            f"code: its skin is {here:.2g} mm from the skin given, expected at most {most:.2g} mm; do they belong "
            "together? `nearest_code` finds a skin's code"
        )
