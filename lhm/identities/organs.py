"""Eyeballs and teeth of the default people: where they are, how large, and how they follow the skin.

They lie where MakeHuman (CC0) has them, and follow the parts of the skin that no expression moves around the eyes, and
of the mouth's lining that the jaw alone does: identity, jaw and effects carry them. An eye stays round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.files.npz import read_arrays
from ..base.mesh import Floats, Ints, Surface
from .anny import ANNY_WITHIN, load_default_people

SMALLER, SHIFT = 0.8, (0.0, -1.4, 0.4)
"""Factor on the radius of MakeHuman's eyeball, and how far [mm] it is set aside, so that it fits its socket.

MakeHuman's has 15.4 mm, an adult's 12 mm; as it is, it goes through the socket's back and through the upper lid.
"""
TEETH = 14
"""Teeth of a row: each half from the middle back, the left one first."""
GUM_OVER, GUM_HEIGHT, GUM_WIDER, GUM_DEEPER = 1.7, 11.0, 1.35, 1.05
"""[mm] A gum covers so much of its crown, and is so high; and its width and depth over the crown's."""
BLUNT = 0.55
"""Power of a sphere's coordinates that makes a crown of it: 1 is an ellipsoid, 0 a box."""


@dataclass(frozen=True, eq=False)
class Organ:
    """An organ that moves as one: points (k, 3) [mm] in the mean skin, those of an eye from its `centre` (3,).

    triangles (t, 3) of the points look outward. `carriers` (c,) are vertices of the skin; `fit` (4, c) gives their
    affine motion from their positions. Teeth follow that motion; an eye, whose `side` is Left or Right, follows its
    rotation, its change of volume and its translation.
    """

    points: Floats
    triangles: Ints
    carriers: Ints
    fit: Floats
    side: str = ""
    centre: Floats | float = 0.0

    def place(self, skin: Floats, gaze: Floats | None = None) -> Floats:
        """Place its points [mm], shape (k, 3), in a skin (n, 3); gaze (3, 3) turns an eye that looks along z."""
        motion = self.fit @ skin[self.carriers]
        if self.side == "":
            return self.points @ motion[:3] + motion[3]
        left, stretch, right = np.linalg.svd(motion[:3])
        points = self.points if gaze is None else self.points @ gaze.T
        return np.cbrt(stretch.prod()) * points @ left @ right + self.centre @ motion[:3] + motion[3]


def make_organs(ball: Surface, bud: Surface) -> tuple[Organ, Organ, Organ, Organ]:
    """Make left eye, right eye, upper teeth and lower teeth of the mean person, of two unit spheres.

    ball: an eye, which looks along z; bud: what the crown of each tooth is shaped of, up along y. The crowns of
    the TEETH of a row follow one another in its points and triangles.
    """
    data, groups, fits = _read_within()
    radius, centres = SMALLER * float(data["radius"]), data["eyes"] + SHIFT
    left, right = (
        Organ(radius * ball.vertices, ball.triangles, groups[k], fits[k], side, centres[k])
        for k, side in enumerate(("Left", "Right"))
    )
    upper, lower = (
        Organ(*_make_row(bud, row), groups[2 + k], fits[2 + k]) for k, row in enumerate(np.split(data["teeth"], 2))
    )
    return left, right, upper, lower


def make_gums(bud: Surface) -> tuple[Organ, Organ]:
    """Make the upper and the lower gums of the mean person, which move as their teeth, of a unit sphere.

    They are rows of buds that overlap, one over the root of each tooth. For drawing alone: nothing touches them.
    """
    data, groups, fits = _read_within()
    gums = []
    for k, (teeth, up) in enumerate(zip(np.split(data["teeth"], 2), (1.0, -1.0), strict=True)):
        row = teeth.copy()
        row[:, 1] += up * (0.5 * teeth[:, 4] - GUM_OVER + 0.5 * GUM_HEIGHT)
        row[:, 3:6] = np.stack([GUM_WIDER * teeth[:, 3], np.full(len(row), GUM_HEIGHT), GUM_DEEPER * teeth[:, 5]], 1)
        gums.append(Organ(*_make_row(bud, row), groups[2 + k], fits[2 + k]))
    upper, lower = gums
    return upper, lower


def _read_within() -> tuple[dict[str, np.ndarray], list[Ints], list[Floats]]:
    """Read where the organs are; the vertices of the skin that carry each of the four, and the fits of their motion."""
    data = read_arrays(
        ANNY_WITHIN, "eyes", "radius", "teeth", "carriers", "counts", kind="the default head's eyes and teeth"
    )
    skin = load_default_people().mean.vertices
    groups = np.split(data["carriers"], np.cumsum(data["counts"])[:-1])
    return data, groups, [np.linalg.pinv(np.hstack([skin[ids], np.ones((len(ids), 1))])) for ids in groups]


def _make_row(bud: Surface, teeth: Floats) -> tuple[Floats, Ints]:
    """Make the crowns of teeth (k, 7), each with its centre, size and turn about y; one after another."""
    crown = 0.5 * np.sign(bud.vertices) * np.abs(bud.vertices) ** BLUNT
    points, triangles = [], []
    for number, tooth in enumerate(teeth):
        sine, cosine = np.sin(tooth[6]), np.cos(tooth[6])
        turn = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
        points.append(crown * tooth[3:6] @ turn + tooth[:3])
        triangles.append(bud.triangles + number * len(crown))
    return np.vstack(points), np.vstack(triangles)
