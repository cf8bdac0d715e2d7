"""Eyeballs and teeth of the default people: drawn, so that a gaze, a blink and an open mouth look like one; no physics.

Lids and lips are simulated as if they were not there. They lie where MakeHuman (CC0) has them, and follow the parts of
the skin that no expression moves around the eyes, and of the mouth's lining that the jaw alone does: identity, jaw and
effects carry them. The eyes stay round and turn by the eyeLook weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.files.npz import read_arrays
from ..lhm.base.mesh import Floats, Ints, Surface
from ..lhm.identities import ANNY_WITHIN, Anny
from ..lhm.identities.arkit import ARKIT

TURN = {"Up": -25.0, "Down": 30.0, "In": 35.0, "Out": 35.0}
"""Degrees of a gaze at full weight: up and down about x, to the nose and away from it about y."""
RINGS = (0, 5, 7, 8, 8.5, 12, 16, 20, 22, 22.5, 23, 24.5, 25, 28, 34, 40, 50, 65, 80, 100, 120, 140, 160, 180)
"""Degrees from where an eye looks."""
ROUND = 40
PUPIL, IRIS, LIMBUS, WHITE, ENAMEL = (18, 16, 16), (92, 126, 138), (44, 56, 62), (236, 231, 224), (238, 230, 212)
BANDS = ((8.2, PUPIL), (22.2, IRIS), (24.8, LIMBUS), (181, WHITE))
"""Up to so many degrees, which colour."""
SMALLER, BACK = 0.93, 1.5
"""Factor on the radius of MakeHuman's eyeball, and how far [mm] it is set back: blendshapes move lids along straight
lines, which cut into a ball that touches them."""


@dataclass(frozen=True, eq=False)
class Body:
    """A body that moves as one: points (k, 3) [mm] in the mean skin, those of an eye from its `centre` (3,).

    `carriers` (c,) are vertices of the skin. `fit` (4, c) gives their affine motion from their positions. Teeth follow
    that motion; an eye, whose `side` is Left or Right, follows its rotation, its change of volume and its translation.
    """

    points: Floats
    carriers: Ints
    fit: Floats
    side: str = ""
    centre: Floats | float = 0.0

    def place(self, skin: Floats, weights: Floats | None) -> Floats:
        """Place its points [mm], shape (k, 3)."""
        motion = self.fit @ skin[self.carriers]
        if self.side == "":
            return self.points @ motion[:3] + motion[3]
        left, stretch, right = np.linalg.svd(motion[:3])
        gaze = self.points @ turn_eye(self.side, weights).T - [0.0, 0.0, BACK]
        return np.cbrt(stretch.prod()) * gaze @ left @ right + self.centre @ motion[:3] + motion[3]


@dataclass(frozen=True, eq=False)
class EyesAndTeeth:
    """Organs within a skin: left eye, right eye, upper and lower teeth.

    `triangles` (m, 3) and `colours` (k, 3), 0 to 255, are those of all points together.
    """

    bodies: Sequence[Body]
    triangles: Ints
    colours: NDArray[np.uint8]

    def place(self, skin: Floats, weights: Floats | None = None) -> Floats:
        """Place their points [mm], shape (k, 3), in a skin (n, 3) that shows an expression of weights (52,)."""
        return np.vstack([body.place(skin, weights) for body in self.bodies])


def find_eyes_and_teeth(skin: Surface) -> EyesAndTeeth | None:
    """Find the organs of a skin of the default triangles; None in another, of which no eyes and teeth are known."""
    return _default() if np.array_equal(skin.triangles, _mean().triangles) else None


def turn_eye(side: str, weights: Floats | None) -> Floats:
    """The rotation (3, 3) of the Left or Right eye, which looks forward at rest."""
    if weights is None:
        return np.eye(3)
    up, down, nose, away = (TURN[way] * weights[ARKIT.index(f"eyeLook{way}{side}")] for way in TURN)
    about_x, about_y = np.radians(up + down), np.radians((away - nose) * (1.0 if side == "Left" else -1.0))
    (sx, cx), (sy, cy) = ((np.sin(angle), np.cos(angle)) for angle in (about_x, about_y))
    return np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])


@cache
def _mean() -> Surface:
    return Anny().mean


@cache
def _default() -> EyesAndTeeth:
    data = read_arrays(
        ANNY_WITHIN, "eyes", "radius", "teeth", "carriers", "counts", kind="the default head's eyes and teeth"
    )
    skin, (ball, faces, colours) = _mean().vertices, _ball()
    groups = np.split(data["carriers"], np.cumsum(data["counts"])[:-1])
    fits = [np.linalg.pinv(np.hstack([skin[ids], np.ones((len(ids), 1))])) for ids in groups]
    ball = ball * float(data["radius"]) * SMALLER
    eyes = [Body(ball, groups[k], fits[k], side, data["eyes"][k]) for k, side in enumerate(("Left", "Right"))]
    crown, sides = _crown()
    teeth = [
        Body(np.vstack([_tooth(crown, tooth) for tooth in row]), groups[2 + k], fits[2 + k])
        for k, row in enumerate(np.split(data["teeth"], 2))
    ]
    count, first = len(data["teeth"]), 2 * len(ball)
    triangles = [faces, faces + len(ball), *(sides + first + k * len(crown) for k in range(count))]
    enamel = np.full((count * len(crown), 3), ENAMEL, dtype=np.uint8)
    return EyesAndTeeth([*eyes, *teeth], np.vstack(triangles), np.vstack([colours, colours, enamel]))


def _tooth(crown: Floats, tooth: Floats) -> Floats:
    """The crown (k, 3) of a tooth: its centre, size and turn."""
    sine, cosine = np.sin(tooth[6]), np.cos(tooth[6])
    return crown * tooth[3:6] @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]]) + tooth[:3]


def _crown() -> tuple[Floats, Ints]:
    """A box of unit size with round edges, in rings about y."""
    up = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
    around = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)

    def blunt(value: Floats) -> Floats:
        return np.sign(value) * np.abs(value) ** 0.55  # 1 is an ellipsoid, 0 a box

    ring = np.stack(
        [np.outer(blunt(np.cos(up)), blunt(np.cos(around))), np.outer(blunt(np.sin(up)), np.ones(16)),
         np.outer(blunt(np.cos(up)), blunt(np.sin(around)))], axis=2,
    )  # fmt: skip
    return 0.5 * ring.reshape(-1, 3), _rings(9, 16)


def _ball() -> tuple[Floats, Ints, NDArray[np.uint8]]:
    """A unit sphere that looks along z, in rings about that axis, with its colours."""
    polar, round_ = np.radians(RINGS), np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    ring = np.stack(
        [np.outer(np.sin(polar), np.cos(round_)), np.outer(np.sin(polar), np.sin(round_)),
         np.outer(np.cos(polar), np.ones(ROUND))], axis=2,
    )  # fmt: skip
    colour = np.array([next(rgb for most, rgb in BANDS if degrees < most) for degrees in RINGS], dtype=np.uint8)
    return ring.reshape(-1, 3), _rings(len(RINGS), ROUND), np.repeat(colour, ROUND, axis=0)


def _rings(count: int, around: int) -> Ints:
    """Triangles between rings of vertices, one after another."""
    k, j = np.meshgrid(np.arange(count - 1), np.arange(around), indexing="ij")
    a, b = k * around + j, k * around + (j + 1) % around
    quads = np.stack([a, a + around, b + around, b], axis=-1).reshape(-1, 4)
    return np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
