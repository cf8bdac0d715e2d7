"""The face as a scene: SoftDECA's inverse energy (Eq. 15) of a layered head, named parameters and an expression.

What the paper's sum has and this scene has not yet: free rigid bones (cranium and mandible are held and moved here),
connecting tets, and contact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..lhm.errors import SceneError
from ..lhm.geometry.rigid import rigid_motion
from ..lhm.head import CRANIUM, MANDIBLE, LayeredHead
from ..lhm.mesh import Floats
from . import terms
from .materials import NeoHookean
from .parameters import STANDARD_GRAVITY, TISSUE_DENSITY, Parameters
from .scene import Scene


def bone_positions(head: LayeredHead, wrap_targets: Floats) -> tuple[np.ndarray, Floats]:
    """Indices into the stacked vertices of all bone, shape (k,), and where an expression puts it [mm], shape (k, 3).

    The cranium stays. The mandible follows the skin over it rigidly: it moves as the best rigid motion of the skin
    wrap's vertices that lie over it.
    """
    n = len(head.bone)
    skull = np.array(head.skull_wrap.vertices)
    jaw = np.flatnonzero(head.bone == MANDIBLE)
    if jaw.size >= 3:
        rotation, translation = rigid_motion(head.skin_wrap.vertices[jaw], wrap_targets[jaw])
        skull[jaw] = skull[jaw] @ rotation.T + translation
    bone = np.flatnonzero((head.bone == CRANIUM) | (head.bone == MANDIBLE))
    return 2 * n + bone, skull[bone]


def facial_scene(head: LayeredHead, parameters: Parameters, targets: Floats) -> Scene:
    """The energy of Eq. 15 for an expression `targets` [mm], shape (skin vertices, 3), as a scene.

    Vertices are the head's stacked wraps. Raises SceneError for targets of another shape or that are not finite.
    """
    targets = np.asarray(targets, dtype=np.float64)
    if targets.shape != head.skin.vertices.shape:
        raise SceneError(f"targets: expected the skin's shape {head.skin.vertices.shape}, got {targets.shape}")
    if not np.isfinite(targets).all():
        raise SceneError(f"targets: {np.count_nonzero(~np.isfinite(targets))} values are not finite")
    p = parameters
    wrap_targets = head.wrap_targets(targets)
    n_wrap = len(head.bone)
    soft = np.arange(len(head.soft.tets))
    muscle = len(soft) + np.arange(len(head.muscle.tets))
    volume = p.volume_ratio * p.soft_stiffness
    bone, placed = bone_positions(head, wrap_targets)
    parts: list[terms.Term] = [
        terms.Strain(p.soft_stiffness, p.strain_limit, tets=soft),
        terms.Volume(volume, p.soft_volume, tets=soft),
        terms.Strain(p.muscle_strain_ratio * p.soft_stiffness, tets=muscle),
        terms.Volume(p.muscle_volume_ratio * volume, p.muscle_volume, tets=muscle),
        terms.SurfaceStrain(head.skin_wrap.triangles, p.skin_stiffness, p.skin_growth),
        terms.Target(np.arange(n_wrap), wrap_targets, p.target_stiffness * head.skin_wrap.vertex_areas),
        terms.Fixed(bone, placed),
    ]
    if p.gravity != 1.0:
        added = np.array([0.0, -(p.gravity - 1.0) * STANDARD_GRAVITY, 0.0])
        parts.append(terms.Gravity(added, TISSUE_DENSITY))
    return Scene(head.vertices, head.tets, tuple(parts))


def neo_hookean_scene(scene: Scene) -> Scene:
    """The scene with each layer's Strain and Volume replaced by the neo-Hookean law of the same small-strain moduli.

    mu = w_str / 2 and lmbda = w_vol / 3: the linearisation of both energies at rest. Raises SceneError where a layer
    has no such counterpart: strain limit or target volume other than 1, or stiffnesses that vary within a term.
    """
    strains, volumes = scene.of(terms.Strain), scene.of(terms.Volume)
    others = [t for t in scene.terms if not isinstance(t, (terms.Strain, terms.Volume))]
    laws: list[terms.Term] = []
    if len(strains) != len(volumes):
        raise SceneError("neo_hookean_scene: each Strain term needs a Volume term on the same tets")
    for strain, volume in zip(strains, volumes, strict=True):
        if not np.array_equal(scene.tets_of(strain), scene.tets_of(volume)):
            raise SceneError("neo_hookean_scene: each Strain term needs a Volume term on the same tets")
        if np.any(strain.limit != 1.0) or np.any(volume.target != 1.0):
            raise SceneError("neo_hookean_scene: a strain limit or target volume other than 1 has no counterpart")
        if np.ptp(strain.stiffness) > 0 or np.ptp(volume.stiffness) > 0:
            raise SceneError("neo_hookean_scene: stiffnesses that vary within a term are not supported")
        law = NeoHookean(mu=float(np.max(strain.stiffness)) / 2, lmbda=float(np.max(volume.stiffness)) / 3)
        laws.append(terms.Hyperelastic(law, tets=strain.tets))
    return replace(scene, terms=(*laws, *others))
