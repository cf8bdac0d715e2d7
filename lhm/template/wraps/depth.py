"""How thick the tissue between skin and skull is: landmark depths, limited by the room there is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...base.kernels import njit
from ...base.mesh import Floats


class Landmark(NamedTuple):
    """A mean depth of soft tissue, its spread, and where both come from.

    `x`, `y`: place in a frame of the face: origin midway between the eyes' centres, x and y in units of half the
    distance between them and of the distance to the mouth; both sides alike, since left and right differ little
    (Meundi and David 2019, abstract). `depth` [mm]; `spread`: standard deviation over the mean.
    """

    name: str
    x: float
    y: float
    depth: float
    source: str
    spread: float = 0.2


# No table was at hand in full. What could be read are lists that quote one, and abstracts; numbers are rounded.
T_TABLE = "rounded, after lists that quote Stephan's T-tables (Stephan and Simpson 2008; means moved < 1.7 mm by 2013)"
MISSES = "such that a mean misses an individual by about 3.5 mm (Hona and Stephan 2023, abstract)"
BETWEEN = "chosen between its neighbours; no table has this place"
LANDMARKS = (
    Landmark("glabella", 0.0, 0.45, 5.5, T_TABLE),
    Landmark("nasion", 0.0, 0.10, 6.0, T_TABLE),
    Landmark("rhinion", 0.0, -0.30, 3.0, "3.07 +- .72 mm in 222 adults (doi 10.1016/j.forsciint.2018.10.021)", 0.23),
    Landmark("mid-philtrum", 0.0, -0.72, 11.0, T_TABLE + "; spread of subnasale, 15.61 +- 2.38 mm (as rhinion)", 0.15),
    Landmark("chin-lip fold", 0.0, -1.30, 10.5, T_TABLE),
    Landmark("chin", 0.0, -1.60, 10.5, T_TABLE),
    Landmark("supraorbital", 1.0, 0.35, 6.0, T_TABLE),
    Landmark("infraorbital", 1.0, -0.25, 6.0, T_TABLE),
    Landmark("zygion", 1.9, -0.10, 6.5, T_TABLE),
    Landmark("cheek", 1.3, -0.65, 14.0, BETWEEN + "; spread as over the masseter", 0.3),
    Landmark("over the masseter", 1.7, -0.80, 18.0, T_TABLE + " (15 to 25 mm); spread " + MISSES, 0.3),
    Landmark("gonion", 1.8, -1.25, 12.0, T_TABLE),
    Landmark("corner of the mouth", 1.0, -1.00, 12.0, BETWEEN),
    Landmark("jaw's edge", 0.7, -1.65, 9.0, BETWEEN),
    Landmark("temple", 1.7, 0.40, 6.0, BETWEEN),
)
SCALP = 5.0  # [mm] rounded, after the same lists
NECK = 14.0  # [mm] chosen: skin to a surface inside the neck, not to a bone
LINING, SOCKET = 4.0, 3.0  # [mm] chosen: mouth and eye sockets have no bone of their own in the template
SPREAD = 0.2  # away from landmarks; chosen between the .15 and .23 that are published
LEAST_DEVIATION = 0.7  # [mm] of a depth's spread; that published at the rhinion
WIDTH = 0.35
LEAST = 0.4
ROOM = 0.8


def mean_depth(points: Floats, eyes: Floats, mouth: Floats) -> Floats:
    """Mean depth [mm] from skin to skull at points of the skin, shape (k,).

    `eyes` (2, 3): the eyes' centres, the subject's left first; `mouth` (3,): the mouth's centre [mm].
    """
    rest = SCALP + (NECK - SCALP) * np.clip((-0.7 - _frame(points, eyes, mouth)[1]) / 0.6, 0.0, 1.0)
    return _blend(points, eyes, mouth, np.array([mark.depth for mark in LANDMARKS]), rest)


def depth_spread(points: Floats, eyes: Floats, mouth: Floats) -> Floats:
    """Standard deviation over the mean of the depth at points of the skin, shape (k,); see `mean_depth`."""
    spread = _blend(points, eyes, mouth, np.array([mark.spread for mark in LANDMARKS]), np.full(len(points), SPREAD))
    return np.maximum(spread, LEAST_DEVIATION / mean_depth(points, eyes, mouth))


def _frame(points: Floats, eyes: Floats, mouth: Floats) -> tuple[Floats, Floats]:
    origin = eyes.mean(axis=0)
    half, drop = 0.5 * np.linalg.norm(eyes[0] - eyes[1]), np.linalg.norm(mouth - origin)
    return np.abs(points[:, 0] - origin[0]) / half, (points[:, 1] - origin[1]) / drop


def _blend(points: Floats, eyes: Floats, mouth: Floats, at_marks: Floats, rest: Floats) -> Floats:
    """The landmarks' values near them in front, `rest` away from them and behind."""
    x, y = _frame(points, eyes, mouth)
    half, origin = 0.5 * np.linalg.norm(eyes[0] - eyes[1]), eyes.mean(axis=0)
    landmarks = np.array([(mark.x, mark.y) for mark in LANDMARKS])
    squared = (0.5 * (x[:, None] - landmarks[:, 0])) ** 2 + (y[:, None] - landmarks[:, 1]) ** 2
    weight = np.exp(-squared / WIDTH**2)
    front = np.clip((points[:, 2] - (origin[2] - 2.6 * half)) / half, 0.0, 1.0)
    # A little weight everywhere lets the value go to the rest's away from all landmarks.
    far = 0.02
    face = (weight @ at_marks + far * rest) / (weight.sum(axis=1) + far)
    return front * face + (1 - front) * rest


@njit(cache=True)
def inscribed_radius(points, normals, most):
    """Radius [mm] of the largest ball inside that touches a closed surface at each of its points, at most `most`.

    A contact counts if seen from the point it lies more than 25 degrees below the tangent plane, so that the point's
    own neighbourhood does not.
    """
    n = len(points)
    radius = np.full(n, most)
    slope = np.sin(np.deg2rad(25.0))
    for i in range(n):
        for j in range(n):
            d0 = points[i, 0] - points[j, 0]
            d1 = points[i, 1] - points[j, 1]
            d2 = points[i, 2] - points[j, 2]
            squared = d0 * d0 + d1 * d1 + d2 * d2
            below = d0 * normals[i, 0] + d1 * normals[i, 1] + d2 * normals[i, 2]
            if squared > 0 and below > slope * np.sqrt(squared):
                radius[i] = min(radius[i], squared / (2 * below))
    return radius
