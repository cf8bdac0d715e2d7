"""Places, regions and bones of a face, from the parts of its skin and how this follows the jaw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ...base.geometry.warp import rigid_motion
from ...base.mesh import Floats, Ints, Surface
from ...head.head import CRANIUM, FREE, MANDIBLE
from ...identities.space import CAP, EYES, MOUTH, OUTSIDE, rim_of
from .depth import inscribed_radius

Mask = NDArray[np.bool_]
FOLLOWS, STAYS, HELD = 0.85, 0.03, 0.08
FROM_LIPS = 12.0
SHEAR = 0.5
"""Skin that departs from the rigid jaw by more than this share of the depth would invert the tissue under it."""


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


def find_landmarks(skin: Surface, parts: Ints) -> Landmarks:
    """Find them on a neutral skin whose vertices' parts are known; +x is the subject's left.

    Without a mouth's lining or eye sockets among the parts there are none: no face is known, and places are NaN.
    """
    rim, lids = (rim_of(skin.triangles, parts, part) for part in (MOUTH, EYES))
    if not len(rim) or not len(lids):
        return Landmarks(rim, lids, np.full(3, np.nan), np.full((2, 3), np.nan))
    sockets = skin.vertices[parts == EYES]
    middle = 0.5 * (skin.vertices[:, 0].min() + skin.vertices[:, 0].max())
    eyes = np.stack([sockets[side].mean(axis=0) for side in (sockets[:, 0] > middle, sockets[:, 0] <= middle)])
    return Landmarks(rim, lids, skin.vertices[rim].mean(axis=0), eyes)


def distance_to(points: Floats, places: Floats) -> Floats:
    """Distance [mm] of each point to the nearest of `places`, shape (k,); infinite if there are none."""
    if not len(places):
        return np.full(len(points), np.inf)
    return cKDTree(places).query(points)[0]


def find_regions(skin: Surface, parts: Ints, landmarks: Landmarks) -> dict[str, Mask]:
    """Masks over the skin's vertices: lips, teeth, mouth, eyes, lids, ears, neck, face.

    "face": visible skin in front of the eyes' plane moved back by the face's width, above the chin's underside;
    "neck": the lid over the cut and all within 25 mm of it; "lips" within 9 mm of the rim, "lids" within 6 mm;
    "teeth": the mouth's lining from 5 to 25 mm behind the rim; "ears": skin at the head's sides, between brow and
    mouth, over tissue less than 12 mm thick, and all within 4 mm of it. Only the neck where no face is known.
    """
    x = skin.vertices
    neck = (parts == CAP) | (distance_to(x, x[parts == CAP]) < 25.0)
    if not landmarks.known:
        return {"neck": neck}
    unit = landmarks.face_width
    centre = landmarks.eyes.mean(axis=0)
    drop = centre[1] - landmarks.mouth[1]
    visible = parts == OUTSIDE
    front = (x[:, 2] > centre[2] - 0.6 * unit) & (np.abs(x[:, 0] - centre[0]) < 2.2 * unit)
    height = (x[:, 1] > centre[1] - 1.75 * drop) & (x[:, 1] < centre[1] + 0.9 * drop)
    rim = distance_to(x, x[landmarks.rim])
    beside = np.abs(x[:, 0] - centre[0]) > 0.6 * np.abs(x[visible, 0] - centre[0]).max()
    between = (x[:, 1] > centre[1] - 1.3 * drop) & (x[:, 1] < centre[1] + 0.6 * drop)
    beside &= distance_to(x, x[landmarks.lids]) > 20.0
    thin = visible & beside & between & (inscribed_radius(x, skin.vertex_normals, 40.0) < 6.0)
    return {
        "lips": visible & (rim < 9.0),
        "lids": visible & (distance_to(x, x[landmarks.lids]) < 6.0),
        "teeth": (parts == MOUTH) & (rim > 5.0) & (rim < 25.0),
        "ears": visible & (distance_to(x, x[thin]) < 4.0) if thin.any() else thin,
        "mouth": parts == MOUTH,
        "eyes": parts == EYES,
        "neck": neck,
        "face": visible & front & height,
    }


def jaw_share(rest: Floats, opened: Floats, candidates: Mask) -> Floats:
    """How far each point follows the rigid motion of the jaw, phi = (moved . rigid) / rigid², shape (n,).

    The motion is fitted to the candidates that move most, again and again to those that follow it.
    """
    motion = opened - rest
    size = np.linalg.norm(motion, axis=1)
    chosen = candidates & (size > 0.6 * size[candidates].max())
    for _ in range(10):
        rotation, translation = rigid_motion(rest[chosen], opened[chosen])
        rigid = rest @ rotation.T + translation - rest
        share = np.einsum("nd,nd->n", motion, rigid) / np.maximum(np.einsum("nd,nd->n", rigid, rigid), 1e-9)
        off = np.linalg.norm(motion - rigid, axis=1)
        chosen = candidates & (off < 0.1 * size + 0.3) & (size > 0.4 * size[candidates].max())
    return share


def label_bones(
    rest: Floats, opened: Floats, depths: Floats, regions: Mapping[str, Mask], from_lips: Floats, edges: csr_matrix
) -> Ints:
    """FREE, CRANIUM or MANDIBLE per vertex, shape (n,), from how the skin over it follows jawOpen.

    `rest`, `opened`: the skin wrap [mm] without and with jawOpen; `depths` [mm]: from there to the skull wrap;
    `from_lips` [mm]: distance to the lips' rim. Mandible: follows the jaw, 12 mm from the lips, not in the mouth, one
    ring eroded, and departs from the jaw's rigid motion by little of the depth. Cranium: hardly moves; at
    the neck's cut a little more is allowed. Lids and what lines the eye sockets glide over the eyeball: FREE.
    """
    inside = regions["mouth"] | regions["eyes"] | regions["neck"]
    far = from_lips > FROM_LIPS
    share = jaw_share(rest, opened, far & ~inside)
    mandible = (share > FOLLOWS) & far & ~inside
    mandible &= (edges @ (~mandible).astype(float)) == 0
    rotation, translation = rigid_motion(rest[mandible], opened[mandible])
    mandible &= np.linalg.norm(opened - rest @ rotation.T - translation, axis=1) < SHEAR * depths
    size = np.linalg.norm(opened - rest, axis=1)
    neck = regions["neck"] & (size < HELD * size.max())
    still = neck | ((size < STAYS * size.max()) & ~regions["mouth"])
    bone = np.full(len(rest), FREE)
    bone[still & far & ~(regions["lids"] | regions["eyes"])] = CRANIUM
    bone[mandible] = MANDIBLE
    return bone


def limit_bones(
    bone: Ints, rest: Floats, opened: Floats, depths: Floats, regions: Mapping[str, Mask], from_lips: Floats
) -> Ints:
    """The given labels (n,), but FREE where tissue needs room to move.

    That is within 12 mm of the lips, in the mouth, at lids and eye sockets, over a cranium whose skin moves, and over a
    mandible from whose rigid motion the skin departs by much of the depth. The arguments are those of `label_bones`.
    The neck's cut, where no bone may be near, is held as CRANIUM.
    """
    far = from_lips > FROM_LIPS
    mandible = (bone == MANDIBLE) & far & ~regions["mouth"]
    rotation, translation = rigid_motion(rest[mandible], opened[mandible])
    mandible &= np.linalg.norm(opened - rest @ rotation.T - translation, axis=1) < SHEAR * depths
    size = np.linalg.norm(opened - rest, axis=1)
    neck = regions["neck"] & (size < HELD * size.max())
    gliding = regions["mouth"] | regions["lids"] | regions["eyes"]
    cranium = ((bone == CRANIUM) & far & ~gliding & (size < HELD * size.max())) | neck
    return np.where(mandible, MANDIBLE, np.where(cranium, CRANIUM, FREE))
