"""Which vertices of the skull wrap belong to the cranium, which to the mandible, and which to neither."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.sparse import csr_matrix

from ..base.geometry.warp import rigid_motion
from ..base.mesh import Floats, Ints
from ..head import CRANIUM, FREE, MANDIBLE
from .landmarks import Mask

FOLLOWS, STAYS, HELD = 0.85, 0.03, 0.08
FROM_LIPS = 12.0
SHEAR = 0.5
"""Skin that departs from the rigid jaw by more than this share of the depth would invert the tissue under it."""


def jaw_share(rest: Floats, opened: Floats, candidates: Mask) -> Floats:
    """How far each point follows the rigid motion of the jaw, phi = (moved . rigid) / rigid², shape (n,).

    The motion is fitted to the candidates that move most, again and again to those that follow it.
    """
    moved = opened - rest
    size = np.linalg.norm(moved, axis=1)
    chosen = candidates & (size > 0.6 * size[candidates].max())
    for _ in range(10):
        rotation, translation = rigid_motion(rest[chosen], opened[chosen])
        rigid = rest @ rotation.T + translation - rest
        share = np.einsum("nd,nd->n", moved, rigid) / np.maximum(np.einsum("nd,nd->n", rigid, rigid), 1e-9)
        off = np.linalg.norm(moved - rigid, axis=1)
        chosen = candidates & (off < 0.1 * size + 0.3) & (size > 0.4 * size[candidates].max())
    return share


def bone_labels(
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
    held = regions["neck"] & (size < HELD * size.max())
    still = held | ((size < STAYS * size.max()) & ~regions["mouth"])
    bone = np.full(len(rest), FREE)
    bone[still & far & ~(regions["lids"] | regions["eyes"])] = CRANIUM
    bone[mandible] = MANDIBLE
    return bone


def held_labels(
    bone: Ints, rest: Floats, opened: Floats, depths: Floats, regions: Mapping[str, Mask], from_lips: Floats
) -> Ints:
    """The given labels (n,), but FREE where tissue needs room to move.

    That is within 12 mm of the lips, in the mouth, at lids and eye sockets, over a cranium whose skin moves, and over a
    mandible from whose rigid motion the skin departs by much of the depth. The arguments are those of `bone_labels`.
    The neck's cut, where no bone may be near, is held as CRANIUM.
    """
    far = from_lips > FROM_LIPS
    mandible = (bone == MANDIBLE) & far & ~regions["mouth"]
    rotation, translation = rigid_motion(rest[mandible], opened[mandible])
    mandible &= np.linalg.norm(opened - rest @ rotation.T - translation, axis=1) < SHEAR * depths
    size = np.linalg.norm(opened - rest, axis=1)
    held = regions["neck"] & (size < HELD * size.max())
    gliding = regions["mouth"] | regions["lids"] | regions["eyes"]
    cranium = ((bone == CRANIUM) & far & ~gliding & (size < HELD * size.max())) | held
    return np.where(mandible, MANDIBLE, np.where(cranium, CRANIUM, FREE))
