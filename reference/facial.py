"""The face as a scene: SoftDECA's inverse energy (Eq. 15) of a layered head, named parameters and an expression.

Skin meets its wrap by the weights of `LayeredHead`: a skin vertex is a point of a wrap triangle, its offset moves along
(the paper leaves this coupling out), so targets act on the wrap per area and no unknown is added.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from ..lhm.errors import SceneError
from ..lhm.head import CRANIUM, FREE, MANDIBLE, LayeredHead
from ..lhm.layers import prism_tets
from ..lhm.mesh import Floats, Ints
from . import terms
from .bones import Bones, carried, jaw_motion, prescribed_bones, rigid_bones, scaled, soft_bones, target_stiffness
from .connecting import Attached, connecting_tets
from .local import TETS_PER_PRISM, on_tets, on_triangles
from .materials import NeoHookean
from .parameters import TISSUE_DENSITY, Parameters
from .scene import Scene

PARTS = ("muscle", "skin")


def facial_scene(
    head: LayeredHead,
    parameters: Parameters,
    targets: Floats,
    *,
    bones: Bones = "prescribed",
    without: Collection[str] = (),
    region: str | np.ndarray | None = None,
    contact: Sequence[str] = (),
    attached: Sequence[Attached] = (),
) -> Scene:
    """The energy of Eq. 15 for an expression `targets` [mm], shape (skin vertices, 3), as a scene.

    Vertices are the head's stacked wraps, then the points of `attached`. Only what p and these choices ask for is
    built. `bones` are "rigid" (cranium held, mandible a free rigid body), "prescribed" (the mandible put where the skin
    over it goes) or "soft" (the paper's stiff surfaces). `without` may name "muscle" (one layer of soft tissue from
    skin to skull) and "skin" (no membrane). `region` keeps the tets at a mask (n,) of the wraps' vertices, or at a
    named one, and holds the others where the expression carries them. `contact` names regions whose triangles are kept
    apart. `attached` things are tied to the skull wrap by connecting tets and replace the bone that they are.
    Raises SceneError for targets of another shape or that are not finite, and for unknown or contradicting choices.
    """
    targets = _checked_targets(head, targets)
    _check_choices(bones, without, attached)
    wrap_targets = head.wrap_targets(targets)
    start = carried(head, parameters, wrap_targets)
    inside = _mask(head, region)
    tissue = _tissue(head, parameters, inside, merged="muscle" in without)
    vertices, bodies = _attach(head, parameters, attached, wrap_targets, tissue, bones)
    n = len(head.bone)
    parts = list(tissue.terms)
    if "skin" not in without:
        parts += _skin(head, parameters, inside)
    parts.append(terms.Target(np.arange(n), wrap_targets, target_stiffness(parameters, head.skin_wrap)))
    elsewhere = {thing.bone for thing in attached} - {FREE}
    if bones == "soft":
        parts += soft_bones(head, parameters)
    elif bones == "rigid":
        parts += rigid_bones(head, parameters, elsewhere)
    else:
        parts += prescribed_bones(head, start, elsewhere)
    idle = _idle(head, inside, merged="muscle" in without)
    if idle.size:
        parts.append(terms.Fixed(idle, start[idle]))
    if np.any(parameters.added_gravity):
        parts.append(terms.Gravity(parameters.added_gravity, TISSUE_DENSITY))
    if contact:
        parts.append(terms.Contact(_touching(head, contact)))
    return Scene(vertices, np.vstack(tissue.tets), (*parts, *bodies))


@dataclass
class _Tissue:
    """Tets and their terms, layer after layer."""

    tets: list[Ints] = field(default_factory=list)
    terms: list[terms.Term] = field(default_factory=list)

    def add(self, tets: Ints, kept: np.ndarray, strain, limit, volume, target):
        """Strain and Volume on those tets (k, 4) that are `kept` (k,); the values are one, or one per tet."""
        first = sum(map(len, self.tets))
        ids = first + np.arange(np.count_nonzero(kept))
        strain, limit, volume, target = (v[kept] if np.ndim(v) else v for v in (strain, limit, volume, target))
        self.tets.append(tets[kept])
        self.terms += [terms.Strain(strain, limit, tets=ids), terms.Volume(volume, target, tets=ids)]


def _tissue(head: LayeredHead, p: Parameters, inside: np.ndarray, *, merged: bool) -> _Tissue:
    """Soft tissue and muscle (Eq. 10 and 12), or soft tissue alone from skin to skull, at the vertices `inside`."""
    wrap = head.skin_wrap
    kept = np.repeat(inside[wrap.triangles].any(axis=1), TETS_PER_PRISM)

    def at(name: str):
        return on_tets(name, getattr(p, name), wrap)

    strain = at("soft_stiffness")
    volume = at("volume_ratio") * strain
    soft = prism_tets(wrap.triangles, 0, 2 * len(head.bone)) if merged else head.soft.tets
    tissue = _Tissue()
    tissue.add(soft, kept, strain, at("strain_limit"), volume, at("soft_volume"))
    if not merged:
        tissue.add(
            head.muscle.tets,
            kept,
            at("muscle_strain_ratio") * strain,
            1.0,
            at("muscle_volume_ratio") * volume,
            at("muscle_volume"),
        )
    return tissue


def _skin(head: LayeredHead, p: Parameters, inside: np.ndarray) -> list[terms.Term]:
    """The skin's membrane (Eq. 11) at the vertices `inside`, and its bending where p has one."""
    wrap = head.skin_wrap
    kept = inside[wrap.triangles].any(axis=1)

    def at(name: str):
        value = on_triangles(name, getattr(p, name), wrap)
        return value[kept] if np.ndim(value) else value

    triangles = wrap.triangles[kept]
    parts: list[terms.Term] = [terms.SurfaceStrain(triangles, at("skin_stiffness"), at("skin_growth"))]
    return parts + ([terms.Bending(triangles, at("skin_bending"))] if np.any(p.skin_bending) else [])


def _attach(
    head: LayeredHead, p: Parameters, attached: Sequence[Attached], wrap_targets: Floats, tissue: _Tissue, bones: Bones
) -> tuple[Floats, list[terms.Term]]:
    """All vertices, and what holds the attached points; their connecting tets go to `tissue`."""
    vertices, bodies = head.vertices, []
    for thing in attached:
        _, tets = connecting_tets(thing.points, head.skull_wrap)
        on_wrap = tets < len(head.bone)
        tets = np.where(on_wrap, tets + 2 * len(head.bone), tets - len(head.bone) + len(vertices))
        ids = len(vertices) + np.arange(len(thing.points))
        vertices = np.vstack([vertices, thing.points])
        strain = p.connector_ratio * float(np.mean(p.soft_stiffness))
        volume = strain * float(np.mean(p.volume_ratio))
        tissue.add(tets, np.ones(len(tets), dtype=bool), strain, 1.0, volume, 1.0)
        bodies.append(_body(head, p, thing, ids, wrap_targets, bones))
    return vertices, bodies


def _body(
    head: LayeredHead, p: Parameters, thing: Attached, ids: Ints, wrap_targets: Floats, bones: Bones
) -> terms.Term:
    if thing.bone == FREE:
        return terms.RigidBody(ids)
    rest = scaled(head, p, thing.bone, thing.points)
    if thing.bone == CRANIUM:
        return terms.Fixed(ids, rest)
    if bones == "rigid":
        return terms.RigidBody(ids, rest)
    rotation, translation = jaw_motion(head, wrap_targets)
    return terms.Fixed(ids, rest @ rotation.T + translation)


def _idle(head: LayeredHead, inside: np.ndarray, *, merged: bool) -> Ints:
    """Stacked vertices outside the region that no bone holds, and a muscle wrap that has no tets."""
    n = len(head.bone)
    out = ~inside
    muscle = np.arange(n) if merged else np.flatnonzero(out)
    return np.concatenate([np.flatnonzero(out), n + muscle, 2 * n + np.flatnonzero(out & (head.bone == FREE))])


def _mask(head: LayeredHead, region: str | np.ndarray | None) -> np.ndarray:
    """A region as a mask over the wraps' vertices, shape (n,); None is the whole head."""
    if region is None:
        return np.ones(len(head.bone), dtype=bool)
    if isinstance(region, str):
        if region not in head.regions:
            raise SceneError(f"region {region!r}: the head has {', '.join(head.regions) or 'none'}")
        return np.asarray(head.regions[region])
    mask = np.asarray(region)
    if mask.shape != head.bone.shape or mask.dtype != bool or not mask.any():
        raise SceneError(f"region: expected a mask of shape {head.bone.shape} with some vertices, got {mask.shape}")
    return mask


def _touching(head: LayeredHead, names: Sequence[str]) -> Ints:
    """The skin wrap's triangles within the union of some regions, shape (k, 3)."""
    touching = np.any([_mask(head, name) for name in names], axis=0)
    return head.skin_wrap.triangles[touching[head.skin_wrap.triangles].all(axis=1)]


def _checked_targets(head: LayeredHead, targets) -> Floats:
    targets = np.asarray(targets, dtype=np.float64)
    if targets.shape != head.skin.vertices.shape:
        raise SceneError(f"targets: expected the skin's shape {head.skin.vertices.shape}, got {targets.shape}")
    if not np.isfinite(targets).all():
        raise SceneError(f"targets: {np.count_nonzero(~np.isfinite(targets))} values are not finite")
    return targets


def _check_choices(bones: str, without: Collection[str], attached: Sequence[Attached]):
    if bones not in get_args(Bones):
        raise SceneError(f"bones {bones!r}: there are {', '.join(get_args(Bones))}")
    unknown = sorted(set(without) - set(PARTS))
    if isinstance(without, str) or unknown:
        raise SceneError(f"without {without!r}: expected some of {', '.join(PARTS)}")
    if bones == "soft" and any(thing.bone in (CRANIUM, MANDIBLE) for thing in attached):
        raise SceneError("soft bones are the skull wrap itself: attach eyes to it, but no bone")


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
