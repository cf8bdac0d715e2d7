"""How thick the tissue between skin and skull is: landmark depths, limited by the room there is."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..mesh import Floats

# Mean facial soft-tissue depths [mm], rounded from published tables (Stephan's T-tables as listed in the forensic
# literature), at places given in a frame of the face: origin midway between the eyes' centres, x and y in units of
# half the distance between them and of the distance to the mouth; both sides alike. A third number would be the
# depth into the head: it is not needed, since the nearest skin is meant.
LANDMARKS = (
    # x, y, depth
    (0.0, 0.45, 5.5),  # glabella
    (0.0, 0.10, 6.0),  # nasion
    (0.0, -0.30, 3.0),  # rhinion
    (0.0, -0.72, 11.0),  # mid-philtrum
    (0.0, -1.30, 10.5),  # chin-lip fold
    (0.0, -1.60, 10.5),  # chin
    (1.0, 0.35, 6.0),  # supraorbital
    (1.0, -0.25, 6.0),  # infraorbital
    (1.9, -0.10, 6.5),  # zygion
    (1.3, -0.65, 14.0),  # cheek
    (1.7, -0.80, 18.0),  # over the masseter
    (1.8, -1.25, 12.0),  # gonion
    (1.0, -1.00, 12.0),  # corner of the mouth
    (0.7, -1.65, 9.0),  # jaw's edge
    (1.7, 0.40, 6.0),  # temple
)
SCALP, LINING, SOCKET = 5.0, 4.0, 3.0
NECK = 14.0
WIDTH = 0.35
LEAST = 0.4
ROOM = 0.8


def wanted_depth(points: Floats, eyes: Floats, mouth: Floats) -> Floats:
    """Depth [mm] from skin to skull at points of the skin, shape (k,).

    `eyes` (2, 3): the eyes' centres, the subject's left first; `mouth` (3,): the mouth's centre [mm].
    """
    origin = eyes.mean(axis=0)
    half, drop = 0.5 * np.linalg.norm(eyes[0] - eyes[1]), np.linalg.norm(mouth - origin)
    x = np.abs(points[:, 0] - origin[0]) / half
    y = (points[:, 1] - origin[1]) / drop
    marks = np.array(LANDMARKS)
    squared = (0.5 * (x[:, None] - marks[:, 0])) ** 2 + (y[:, None] - marks[:, 1]) ** 2
    weight = np.exp(-squared / WIDTH**2)
    front = np.clip((points[:, 2] - (origin[2] - 2.6 * half)) / half, 0.0, 1.0)
    # A little weight everywhere lets the depth go to the scalp's or the neck's away from all landmarks.
    far = 0.02
    rest = SCALP + (NECK - SCALP) * np.clip((-0.7 - y) / 0.6, 0.0, 1.0)
    face = (weight @ marks[:, 2] + far * rest) / (weight.sum(axis=1) + far)
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
