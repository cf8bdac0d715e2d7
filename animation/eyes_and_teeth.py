"""Eyeballs, teeth and gums of the default people as they are drawn: fine surfaces with colours, and eyes that look.

`lhm.identities.organs` says where they are. The eyes turn by the eyeLook weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.mesh import Floats, Ints, Surface
from ..lhm.identities.anny import has_default_triangles
from ..lhm.identities.arkit import ARKIT
from ..lhm.identities.organs import Organ, make_gums, make_organs

TURN = {"Up": -25.0, "Down": 30.0, "In": 35.0, "Out": 35.0}
"""Degrees of a gaze at full weight: up and down about x, to the nose and away from it about y."""
RINGS = (0, 5, 8, 9.3, 9.8, 14, 18.5, 23, 25.8, 26.3, 27, 28.8, 29.3, 32, 37, 43, 50, 65, 80, 100, 120, 140, 160, 180)
"""Degrees from where an eye looks."""
ROUND = 40
PUPIL, IRIS, LIMBUS, WHITE = (18, 16, 16), (92, 126, 138), (44, 56, 62), (236, 231, 224)
ENAMEL, GUM = (238, 230, 212), (186, 98, 96)
BANDS = ((9.5, PUPIL), (26, IRIS), (29, LIMBUS), (181, WHITE))
"""Up to so many degrees, which colour."""


@dataclass(frozen=True, eq=False)
class EyesAndTeeth:
    """Organs within a skin: left eye, right eye, upper and lower teeth, upper and lower gums.

    `triangles` (m, 3) and `colours` (k, 3), 0 to 255, are those of all points together.
    """

    organs: Sequence[Organ]
    triangles: Ints
    colours: NDArray[np.uint8]

    def place(self, skin: Floats, weights: Floats | None = None) -> Floats:
        """Place their points [mm], shape (k, 3), in a skin (n, 3) that shows an expression of weights (52,)."""
        return np.vstack([organ.place(skin, turn_eye(organ.side, weights)) for organ in self.organs])


def find_eyes_and_teeth(skin: Surface) -> EyesAndTeeth | None:
    """Find the organs of a skin of the default triangles; None in another, of which no eyes and teeth are known."""
    return _default() if has_default_triangles(skin) else None


def turn_eye(side: str, weights: Floats | None) -> Floats:
    """The rotation (3, 3) of the Left or Right eye, which looks forward at rest; what is no eye does not turn."""
    if weights is None or not side:
        return np.eye(3)
    up, down, nose, away = (TURN[way] * weights[ARKIT.index(f"eyeLook{way}{side}")] for way in TURN)
    about_x, about_y = np.radians(up + down), np.radians((away - nose) * (1.0 if side == "Left" else -1.0))
    (sx, cx), (sy, cy) = ((np.sin(angle), np.cos(angle)) for angle in (about_x, about_y))
    return np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])


@cache
def _default() -> EyesAndTeeth:
    x, y, z = _sphere(np.radians(RINGS), ROUND).T
    ball = Surface(np.stack([x, y, z], axis=1), _rings(len(RINGS), ROUND))
    x, y, z = _sphere(np.linspace(np.pi, 0.0, 9), 16).T
    bud = Surface(np.stack([x, z, y], axis=1), _rings(9, 16))
    organs = (*make_organs(ball, bud), *make_gums(bud))
    colour = np.array([next(rgb for most, rgb in BANDS if degrees < most) for degrees in RINGS], dtype=np.uint8)
    colours = [np.repeat(colour, ROUND, axis=0)] * 2
    for row, rgb in zip(organs[2:], (ENAMEL, ENAMEL, GUM, GUM), strict=True):
        colours.append(np.tile(np.array(rgb, dtype=np.uint8), (len(row.points), 1)))
    firsts = np.cumsum([0, *(len(organ.points) for organ in organs)])
    triangles = [organ.triangles + first for organ, first in zip(organs, firsts, strict=False)]
    return EyesAndTeeth(organs, np.vstack(triangles), np.vstack(colours))


def _sphere(polar: Floats, around: int) -> Floats:
    """A unit sphere in rings about z, at these angles from it, (rings x around, 3)."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    ring = np.stack(
        [np.outer(np.sin(polar), np.cos(azimuth)), np.outer(np.sin(polar), np.sin(azimuth)),
         np.outer(np.cos(polar), np.ones(around))], axis=2,
    )  # fmt: skip
    return ring.reshape(-1, 3)


def _rings(count: int, around: int) -> Ints:
    """Triangles between rings of vertices, one after another."""
    k, j = np.meshgrid(np.arange(count - 1), np.arange(around), indexing="ij")
    a, b = k * around + j, k * around + (j + 1) % around
    quads = np.stack([a, a + around, b + around, b], axis=-1).reshape(-1, 4)
    return np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
