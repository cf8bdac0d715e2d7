"""Cranium and mandible in a facial scene: rigid bodies, prescribed places, or the paper's stiff surfaces (Eq. 13).

Indices are into a scene's vertices, among which the skull wrap's stand in one run.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

import numpy as np

from ...lhm.base.geometry.warp import rigid_motion
from ...lhm.base.mesh import Floats
from ...lhm.head.head import CRANIUM, FREE, MANDIBLE, LayeredHead
from .. import terms
from .parameters import Parameters

Bones = Literal["rigid", "prescribed", "soft"]

BONE_STIFFNESS = 1e3
"""Stiffness of bone over that of skin in the soft mode (Eq. 13)."""
HOLD = 10.0
"""Stiffness of the springs that hold a soft cranium behind the face, over the mean of the targets'."""
CONDYLE = 0.05
"""The mandible is scaled about the mean of this share of its vertices, the highest behind its middle."""


def scale_bone(head: LayeredHead, parameters: Parameters, bone: int, points: Floats) -> Floats:
    """Scale points [mm], shape (k, 3), of a bone by p: a cranium about its middle, a mandible about its condyles."""
    scale = parameters.scale("cranium" if bone == CRANIUM else "mandible")
    wrap = head.skull_wrap.vertices[head.bone == bone]
    if not len(wrap) or np.all(scale == 1.0):
        return points
    centre = wrap.mean(axis=0) if bone == CRANIUM else condyles(wrap)
    return centre + scale * (points - centre)


def condyles(mandible: Floats) -> Floats:
    """Find the middle of a mandible's highest part behind its own middle [mm], about which it turns."""
    behind = mandible[mandible[:, 2] <= np.median(mandible[:, 2])]
    highest = behind[np.argsort(behind[:, 1])[-max(3, int(CONDYLE * len(mandible))) :]]
    return highest.mean(axis=0)


def scale_skull(head: LayeredHead, parameters: Parameters) -> Floats:
    """Scale cranium and mandible of the skull wrap [mm], shape (n, 3), by p; free vertices stay."""
    skull = np.array(head.skull_wrap.vertices)
    for bone in (CRANIUM, MANDIBLE):
        skull[head.bone == bone] = scale_bone(head, parameters, bone, skull[head.bone == bone])
    return skull


def jaw_motion(head: LayeredHead, neutral: Floats, wrap_targets: Floats) -> tuple[Floats, Floats]:
    """Fit the rotation (3, 3) and translation (3,) [mm] by which an expression moves the skin over the mandible."""
    jaw = np.flatnonzero(head.bone == MANDIBLE)
    if jaw.size < 3:
        return np.eye(3), np.zeros(3)
    return rigid_motion(neutral[jaw], wrap_targets[jaw])


def carry_wraps(
    head: LayeredHead, parameters: Parameters, neutral: Floats, wrap_targets: Floats
) -> tuple[Floats, Floats, Floats]:
    """Carry skin, muscle and skull wrap [mm], each of shape (n, 3), along with an expression, without physics.

    The skin wrap is at its targets, the scaled mandible moved as the skin over it from `neutral`, the skin wrap under p
    alone; skull-wrap vertices that are no bone go with the skin, and the muscle wrap lies between as it does at rest.
    """
    skin, muscle, rest = (wrap.vertices for wrap in (head.skin_wrap, head.muscle_wrap, head.skull_wrap))
    rotation, translation = jaw_motion(head, neutral, wrap_targets)
    displacement = wrap_targets - skin
    skull = scale_skull(head, parameters)
    skull[head.bone == MANDIBLE] = skull[head.bone == MANDIBLE] @ rotation.T + translation
    skull[head.bone == FREE] += displacement[head.bone == FREE]
    depth = np.linalg.norm(rest - skin, axis=1)
    share = np.clip(np.linalg.norm(muscle - skin, axis=1) / np.maximum(depth, 1e-12), 0.0, 1.0)[:, None]
    return wrap_targets, muscle + (1.0 - share) * displacement + share * (skull - rest), skull


def rigid_bones(
    head: LayeredHead, parameters: Parameters, first: int, elsewhere: Collection[int] = ()
) -> list[terms.Term]:
    """Make a cranium that is held, and a mandible that is free but rigid, less the bones that are `elsewhere`.

    first: index of the skull wrap's first vertex.
    """
    skull = scale_skull(head, parameters)
    cranium, jaw = (np.flatnonzero((head.bone == b) & (b not in elsewhere)) for b in (CRANIUM, MANDIBLE))
    parts: list[terms.Term] = [terms.Fixed(first + cranium, skull[cranium])] if cranium.size else []
    return parts + ([terms.RigidBody(first + jaw, skull[jaw])] if jaw.size >= 3 else [])


def prescribed_bones(head: LayeredHead, skull: Floats, first: int, elsewhere: Collection[int] = ()) -> list[terms.Term]:
    """Fix cranium and mandible where the skull wrap `skull` (n, 3) [mm] has them; see `rigid_bones`."""
    bone = np.flatnonzero(np.isin(head.bone, [b for b in (CRANIUM, MANDIBLE) if b not in elsewhere]))
    return [terms.Fixed(first + bone, skull[bone])] if bone.size else []


def soft_bones(head: LayeredHead, parameters: Parameters, stack: Floats, first: int) -> list[terms.Term]:
    """Make the paper's bones: stiff surfaces that keep their curvature, and springs on the cranium behind the face.

    stack: the scene's vertices at rest [mm]; first: index of the skull wrap's first.
    """
    wrap = head.skull_wrap
    labels = head.bone[wrap.triangles]
    triangles = wrap.triangles[(labels > 0).all(axis=1) & (labels == labels[:, :1]).all(axis=1)]
    if not len(triangles):
        return []
    rest = np.array(stack)
    rest[first : first + len(head.bone)] = scale_skull(head, parameters)
    stiffness = BONE_STIFFNESS * float(np.mean(parameters.skin_stiffness))
    edge = float(np.mean(np.linalg.norm(np.diff(wrap.vertices[triangles[:, :2]], axis=1), axis=2)))
    behind = np.flatnonzero((head.bone == CRANIUM) & ~head.regions.get("face", np.zeros(len(head.bone), dtype=bool)))
    spring = HOLD * float(np.mean(parameters.target_stiffness)) * wrap.vertex_areas[behind]
    return [
        terms.SurfaceStrain(first + triangles, stiffness, rest=rest),
        terms.Bending(first + triangles, stiffness * edge**2, rest=rest),
        terms.Target(first + behind, rest[first + behind], spring),
    ]
