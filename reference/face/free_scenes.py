"""Scenes in which no target holds the face: a jaw that opens by its bone, and a cheek that is pushed.

Targets of an expression pin the skin, and hide there what one law changes against another. Here bones and loads move
the flesh, and skin goes where the tissue below takes it. Only what lines mouth and eyes is held: the model has no bone
behind it. It goes where the bones carry it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from ...lhm.head.columns import fill_harmonically
from ...lhm.head.flesh import cheek_share
from ...lhm.head.head import FREE, MANDIBLE, LayeredHead
from .. import terms
from ..scene import Scene
from ..terms.term import as_vector
from .bones import condyles, scale_skull
from .facial import facial_scene
from .parameters import Parameters
from .tissue import CellKind

LINING = ("mouth", "teeth", "eyes")
"""Regions behind which there is no bone; lips belong to the mouth and are left free."""
WIDEST = 45.0
"""[degrees] to which a jaw may be opened."""
HARDEST, BROADEST = 100.0, 200.0
"""[kPa] with which a cheek may be pushed, and [mm] of the patch' radius."""


def open_jaw_scene(
    head: LayeredHead, parameters: Parameters, *, angle: float = 12.0, cells: CellKind = "prisms"
) -> Scene:
    """Build the scene of a jaw that its bone opens by an angle [degrees], 0 to 45, with a cranium that stays.

    The mandible turns about the x axis through `jaw_hinge`. Gravity and the tissues' stiffnesses are those of p. Raises
    SceneError for an angle out of range, and for a head without a mandible.
    """
    if not 0.0 <= angle <= WIDEST:
        raise SceneError(f"angle: expected 0 to {WIDEST:g} degrees, got {angle:g}")
    jaw = head.bone == MANDIBLE
    if not jaw.any():
        raise SceneError("open_jaw_scene: the head has no mandible")
    about, skull = jaw_hinge(head), scale_skull(head, parameters)
    turn = Rotation.from_euler("x", angle, degrees=True).as_matrix()
    skull[jaw] = about + (skull[jaw] - about) @ turn.T
    return _scene_of_bones(head, parameters, skull, cells)


def push_cheek_scene(
    head: LayeredHead,
    parameters: Parameters,
    *,
    pressure: float = 0.25,
    radius: float = 15.0,
    centre: Floats | None = None,
) -> Scene:
    """Build the scene of a cheek that a traction pushes in, with both bones at rest.

    pressure [kPa] acts on the skin wrap's triangles within `radius` [mm] of `centre` [mm], shape (3,), along their mean
    normal at rest; the centre is by default the middle of the left cheek. There is no contact: on the default head the
    cheek goes 4 mm in at 0.25 kPa, and at 0.5 kPa, 9 mm, it crosses the lining of the mouth. Raises SceneError for a
    pressure beyond 0 to 100 kPa, a radius beyond 0 to 200 mm and a patch without triangles, and InputError for a head
    without the regions that tell where its cheeks are.
    """
    if not 0.0 <= pressure <= HARDEST:
        raise SceneError(f"pressure: expected 0 to {HARDEST:g} kPa, got {pressure:g}")
    if not 0.0 <= radius <= BROADEST:
        raise SceneError(f"radius: expected 0 to {BROADEST:g} mm, got {radius:g}")
    x, triangles = head.skin_wrap.vertices, head.skin_wrap.triangles
    if centre is None:
        share = cheek_share(head) * (x[:, 0] > 0.0)  # of the left cheek
        centre = x[np.argmin(np.linalg.norm(x - share @ x / share.sum(), axis=1))]
    about = as_vector("centre", centre)
    near = np.linalg.norm(x - about, axis=1) <= radius
    patch = triangles[near[triangles].all(axis=1)]
    if not len(patch):
        raise SceneError(f"radius {radius:g} mm: no triangle of the skin wrap lies so near {np.round(about, 1)}")
    a, b, c = (x[patch[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a).sum(axis=0)
    push = terms.Traction(patch, -pressure * normal / np.linalg.norm(normal))
    scene = _scene_of_bones(head, parameters, scale_skull(head, parameters))
    return replace(scene, terms=(*scene.terms, push))


def jaw_hinge(head: LayeredHead) -> Floats:
    """Return a point [mm], shape (3,), of the axis about which a jaw opens: midway between the ears.

    A jaw's joints lie about a centimetre in front of that. A head without ears has `condyles` in their place.
    """
    ears = head.regions.get("ears")
    if ears is not None and ears.any():
        middle: Floats = head.skin_wrap.vertices[ears].mean(axis=0)
        return middle
    return condyles(head.skull_wrap.vertices[head.bone == MANDIBLE])


def _scene_of_bones(head: LayeredHead, parameters: Parameters, skull: Floats, cells: CellKind = "prisms") -> Scene:
    """Hold both bones where the skull wrap `skull` [mm], shape (n, 3), has them, and springs on the lining alone."""
    scene = facial_scene(head, parameters, head.skin.vertices, bones="prescribed", cells=cells)
    motion = skull - head.skull_wrap.vertices
    bone = head.bone != FREE
    carried = head.skin_wrap.vertices + (
        fill_harmonically(head.skull_wrap.triangles, motion, bone) if motion.any() else np.zeros_like(motion)
    )
    none = np.zeros(len(bone), dtype=bool)
    lining = np.any([head.regions.get(name, none) for name in LINING], axis=0) & ~head.regions.get("lips", none)

    def change_term(term: terms.Term) -> terms.Term:
        if isinstance(term, terms.Fixed):
            return replace(term, values=skull[bone])
        if isinstance(term, terms.Target):
            return replace(term, positions=carried, stiffness=term.stiffness * lining)
        return term

    return replace(scene, terms=tuple(change_term(term) for term in scene.terms))
