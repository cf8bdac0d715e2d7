"""Places and regions of a skin that follow from its parts: the lips' rim, the lids, the eyes' centres, masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.mesh import Floats, Ints, Surface
from ..identities.space import CAP, EYES, MOUTH, OUTSIDE
from .depth import inscribed_radius

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Skin vertices on the rim between visible skin and a pocket, and points [mm] derived from them."""

    rim: Ints
    lids: Ints
    mouth: Floats
    eyes: Floats

    @property
    def known(self) -> bool:
        """Whether mouth and eyes were found."""
        return bool(np.isfinite(self.mouth).all())

    @property
    def face_width(self) -> float:
        """Half the distance between the eyes [mm], the unit of the face."""
        return 0.5 * float(np.linalg.norm(self.eyes[0] - self.eyes[1]))


def landmarks(skin: Surface, parts: Ints) -> Landmarks:
    """Find them on a neutral skin whose vertices' parts are known; +x is the subject's left.

    Without a mouth's lining or eye sockets among the parts there are none: no face is known, and places are NaN.
    """
    rim, lids = (_rim(skin.triangles, parts, part) for part in (MOUTH, EYES))
    if not len(rim) or not len(lids):
        return Landmarks(rim, lids, np.full(3, np.nan), np.full((2, 3), np.nan))
    sockets = skin.vertices[parts == EYES]
    middle = 0.5 * (skin.vertices[:, 0].min() + skin.vertices[:, 0].max())
    eyes = np.stack([sockets[side].mean(axis=0) for side in (sockets[:, 0] > middle, sockets[:, 0] <= middle)])
    return Landmarks(rim, lids, skin.vertices[rim].mean(axis=0), eyes)


def _rim(triangles: Ints, parts: Ints, part: int) -> Ints:
    mixed = triangles[(parts[triangles] == part).any(axis=1)]
    return np.unique(mixed[parts[mixed] == OUTSIDE])


def distance_to(points: Floats, places: Floats) -> Floats:
    """Distance [mm] of each point to the nearest of `places`, shape (k,); infinite if there are none."""
    if not len(places):
        return np.full(len(points), np.inf)
    return cKDTree(places).query(points)[0]


def regions(skin: Surface, parts: Ints, marks: Landmarks) -> dict[str, Mask]:
    """Masks over the skin's vertices: lips, teeth, mouth, eyes, lids, ears, neck, face.

    "face": visible skin in front of the eyes' plane moved back by the face's width, above the chin's underside;
    "neck": the lid over the cut and all within 25 mm of it; "lips" within 9 mm of the rim, "lids" within 6 mm;
    "teeth": the mouth's lining from 5 to 25 mm behind the rim; "ears": skin at the head's sides, between brow and
    mouth, over tissue less than 12 mm thick, and all within 4 mm of it. Only the neck where no face is known.
    """
    x = skin.vertices
    neck = (parts == CAP) | (distance_to(x, x[parts == CAP]) < 25.0)
    if not marks.known:
        return {"neck": neck}
    unit = marks.face_width
    centre = marks.eyes.mean(axis=0)
    drop = centre[1] - marks.mouth[1]
    visible = parts == OUTSIDE
    front = (x[:, 2] > centre[2] - 0.6 * unit) & (np.abs(x[:, 0] - centre[0]) < 2.2 * unit)
    height = (x[:, 1] > centre[1] - 1.75 * drop) & (x[:, 1] < centre[1] + 0.9 * drop)
    rim = distance_to(x, x[marks.rim])
    beside = np.abs(x[:, 0] - centre[0]) > 0.6 * np.abs(x[visible, 0] - centre[0]).max()
    between = (x[:, 1] > centre[1] - 1.3 * drop) & (x[:, 1] < centre[1] + 0.6 * drop)
    beside &= distance_to(x, x[marks.lids]) > 20.0
    thin = visible & beside & between & (inscribed_radius(x, skin.vertex_normals, 40.0) < 6.0)
    return {
        "lips": visible & (rim < 9.0),
        "lids": visible & (distance_to(x, x[marks.lids]) < 6.0),
        "teeth": (parts == MOUTH) & (rim > 5.0) & (rim < 25.0),
        "ears": visible & (distance_to(x, x[thin]) < 4.0) if thin.any() else thin,
        "mouth": parts == MOUTH,
        "eyes": parts == EYES,
        "neck": neck,
        "face": visible & front & height,
    }
