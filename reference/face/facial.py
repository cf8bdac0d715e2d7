"""The face as a scene: SoftDECA's inverse energy (Eq. 15) of a layered head, named parameters and an expression.

Skin meets its wrap by the weights of `LayeredHead`: a skin vertex is a point of a wrap triangle, its offset moves along
(the paper leaves this coupling out), so targets act on the wrap per area and no unknown is added.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from ...lhm.base.checks import array_of_kind
from ...lhm.base.errors import SceneError
from ...lhm.base.geometry.likeness import check_moved
from ...lhm.base.mesh import Floats, Ints, tet_volumes
from ...lhm.head.head import CRANIUM, FREE, MANDIBLE, LayeredHead
from .. import terms
from ..added import added_laws
from ..materials import Material, NeoHookean
from ..scene import Scene
from .bones import Bones, carry_wraps, jaw_motion, prescribed_bones, rigid_bones, scale_bone, soft_bones
from .organs import RigidOrgan, make_obstacles
from .palsy import Springs
from .parameters import TETS_PER_PRISM, TISSUE_DENSITY, Parameters, spread_to_tets, spread_to_triangles
from .tissue import POLICY, Attachment, CellKind, Guard, Stack, connecting_tets, group_cells, guard_stiffness, on_cells

PARTS = ("muscle", "skin")
OF_TETS = (
    "soft_stiffness",
    "volume_ratio",
    "strain_limit",
    "soft_volume",
    "muscle_strain_ratio",
    "muscle_volume_ratio",
    "muscle_volume",
)
GAP = 0.1
"""Gap that contact leaves between surfaces [mm], as thin as a film of tears, or the gap at rest if that is less."""
HOURGLASS = 0.05
"""Stiffness of prisms' Hourglass over Strain's.

Of .0125, .025, .05, .1 and .2 eleven neutral faces of ten people (weight, gravity, growth, muscle, jaw) miss 10.5,
10.4, 10.4, 10.9 and 12.0 % of quadratic tets' motion in the mean. From .05 on none is rougher than by quadratic tets by
more than 4 % (10 % at .0125), and grown skin takes half the iterations that it takes at .0125. Over twenty more, half
or twice the share changes 1 % of the motion, 3 % of grown skin's. No prism was inverted, and pictures show no pattern
that quadratic tets have not.
"""
PD_ENERGY = "PD"
"""The law that is projective dynamics' own energy, Strain and Volume."""
LAWS: dict[str, Callable[[float, float], Material]] = {"neo-Hookean": NeoHookean}
"""Hyperelastic laws of a face by name, made of Lamé's moduli mu and lmbda [kPa]."""
FaceLaw = str | Callable[[float, float], Material]
"""PD_ENERGY, a name of LAWS or of `add_law`, or a law's function of Lamé's moduli."""
CONTACT_REGIONS = ("lips", "mouth", "lids", "eyes")
"""Regions that touch one another as a face moves: lids, lips, and the skin that lines eyes and mouth."""
WIDER = 3
"""Edges by which regions in contact reach further, since lips that roll in meet beyond their red."""


def facial_scene(
    head: LayeredHead,
    parameters: Parameters,
    targets: Floats,
    *,
    neutral: Floats | None = None,
    bones: Bones = "rigid",
    layers: tuple[int, int] = (1, 1),
    cells: CellKind = "prisms",
    without: Collection[str] = (),
    region: str | np.ndarray | None = None,
    contact: Sequence[str | np.ndarray] = (),
    organs: Sequence[RigidOrgan] = (),
    attached: Sequence[Attachment] = (),
) -> Scene:
    """Build the energy of Eq. 15 for an expression `targets` [mm], shape (skin vertices, 3), as a scene.

    Vertices are the head's, the skin wrap's first, then the points of `attached`. Only what p and these choices ask
    for is built. `neutral` [mm], of the targets' shape, is the skin at rest, by default the head's: where what lines
    a paralysed eye is tied (see `palsy`). `bones` are "rigid" (cranium held, mandible a free rigid body),
    "prescribed" (the mandible put where the skin over it goes) or "soft" (the paper's stiff surfaces). `layers` of
    tets divide soft tissue and muscle from wrap to wrap. Their `cells`, which have one deformation each, are "prisms"
    of three tets, or "tets", which lock: by them a neutral face settles a third off what converged elements say.
    `without` may name "muscle" (soft tissue from skin to skull, no muscle wrap) and "skin" (no membrane). `region`
    keeps the tets at a mask (n,) of the wraps' vertices, or at a named one, and holds the others where the expression
    carries them; a head's own volume mesh is taken whole, by tets, with one number per parameter of its tets.
    `contact` names regions whose triangles are kept apart, and off `organs`; those of a mandible that is soft, or
    attached, are left out.
    `attached` things are tied to the skull wrap by connecting tets and replace the bone that they are.
    Raises SceneError for targets of another shape or that no expression makes of the skin, by unit, place or order of
    vertices, and for unknown or contradicting choices.
    """
    targets = check_targets(head, targets)
    neutral = head.skin.vertices if neutral is None else check_targets(head, neutral, "neutral")
    _check_choices(bones, cells, without, attached)
    wrap_targets, rest = head.wrap_targets(targets), head.wrap_targets(neutral)
    stack = Stack.from_head(head, layers, without)
    start = carry_wraps(head, parameters, rest, wrap_targets)
    inside = _region_mask(head, region)
    tissue = _make_tissue(head, parameters, stack, inside, cells)
    vertices, bodies = _attach(head, parameters, attached, (rest, wrap_targets), stack, tissue, bones)
    parts = list(tissue.terms)
    if "skin" not in without:
        parts += _make_skin(head, parameters, inside)
    springs = Springs.from_head(head, parameters)
    drawn_to = springs.positions(wrap_targets, rest)
    triangles = head.skin_wrap.triangles
    triangles = triangles[inside[triangles].any(axis=1)]
    lumped = cells == "tets" or stack.counts is None
    parts.append(terms.Target(np.arange(len(drawn_to)), drawn_to, springs.stiffness, triangles, lumped))
    elsewhere, first = {thing.bone for thing in attached} - {FREE}, stack.first_of_skull
    if bones == "soft":
        parts += soft_bones(head, parameters, vertices, first)
    elif bones == "rigid":
        parts += rigid_bones(head, parameters, first, elsewhere)
    else:
        parts += prescribed_bones(head, start[2], first, elsewhere)
    if not inside.all():
        outside = np.tile(~inside, len(stack.vertices) // len(inside))
        outside[first:] &= head.bone == FREE  # bones are held by terms of their own
        idle = np.flatnonzero(outside)
        if idle.size:
            parts.append(terms.Fixed(idle, stack.interpolate(*start)[idle]))
    if np.any(parameters.added_gravity):
        parts.append(terms.Gravity(parameters.added_gravity, TISSUE_DENSITY))
    if contact:
        moving = bones != "soft" and MANDIBLE not in elsewhere
        obstacles = make_obstacles(head, parameters, organs, first, moving)
        parts.append(terms.Contact(contact_triangles(head, contact), thickness=GAP, obstacles=obstacles))
    tets = np.vstack(tissue.tets)
    return Scene(vertices, tets, (*parts, *bodies), columns=stack.find_columns(tets))


@dataclass
class _Tissue:
    """Tets over `vertices` [mm], their terms, layer after layer, and guards of those that are thin."""

    vertices: Floats
    tets: list[Ints] = field(default_factory=list)
    terms: list[terms.Term] = field(default_factory=list)
    guards: list[Guard] = field(default_factory=list)

    def add(
        self,
        tets: Ints,
        kept: np.ndarray,
        strain,
        limit,
        volume,
        target,
        *,
        kind: CellKind = "tets",
        guarded: bool = False,
    ):
        """Put Strain and Volume, and Hourglass where they are prisms, on cells of those tets (k, 4) that are `kept`.

        Values are one for all, or one per tet of the first of several equal layers. kept: a mask (k,).
        """
        first = sum(map(len, self.tets))
        own = tets[kept]
        self.tets.append(own)
        volumes = tet_volumes(self.vertices, own) if kind == "prisms" else np.ones(len(own))

        def spread(value):
            return np.tile(value, len(tets) // len(value))[kept] if np.ndim(value) else value

        strain, limit, volume, target = map(spread, (strain, limit, volume, target))
        guard = guard_stiffness(self.vertices, own, strain) if guarded else np.zeros(len(own))
        for cells in group_cells(kept, kind):
            w, e, v, t, g = (on_cells(value, cells, volumes) for value in (strain, limit, volume, target, guard))
            ids = first + cells
            self.terms += [terms.Strain(w, e, tets=ids), terms.Volume(v, t, tets=ids)]
            if cells.ndim == 2:
                self.terms.append(terms.Hourglass(HOURGLASS * w, ids))
            thin = np.flatnonzero(g)
            if thin.size:
                self.guards.append(Guard(np.take(g, thin), POLICY.free_stretch, tets=ids[thin]))


def _make_tissue(head: LayeredHead, p: Parameters, stack: Stack, inside: np.ndarray, kind: CellKind) -> _Tissue:
    """Make soft tissue and muscle (Eq. 10 and 12) at the vertices `inside`, and guard soft tissue's thin cells."""
    wrap = head.skin_wrap
    layer = np.repeat(inside[wrap.triangles].any(axis=1), TETS_PER_PRISM)
    if stack.counts is None:
        _check_uniform(p, inside)
        kind = "tets"

    def keep_terms(tets: Ints) -> np.ndarray:
        mask = np.ones(len(tets), dtype=bool) if stack.counts is None else np.tile(layer, len(tets) // len(layer))
        return mask if stack.sound is None else mask & stack.sound

    def value(name: str):
        return spread_to_tets(name, getattr(p, name), wrap)

    tissue = _Tissue(stack.vertices)
    strain = value("soft_stiffness")
    volume, limit, target = value("volume_ratio") * strain, value("strain_limit"), value("soft_volume")
    tissue.add(stack.soft, keep_terms(stack.soft), strain, limit, volume, target, kind=kind, guarded=True)
    if stack.muscle is not None:
        strain, volume = value("muscle_strain_ratio") * strain, value("muscle_volume_ratio") * volume
        tissue.add(stack.muscle, keep_terms(stack.muscle), strain, 1.0, volume, value("muscle_volume"), kind=kind)
    tissue.terms += tissue.guards
    return tissue


def _check_uniform(p: Parameters, inside: np.ndarray) -> None:
    """Raise SceneError for values per triangle of the wraps where no tet belongs to one."""
    if not inside.all():
        raise SceneError("region: a head whose tets are a volume mesh is simulated as a whole")
    for name in OF_TETS:
        if np.ndim(getattr(p, name)):
            raise SceneError(
                f"parameter {name}: expected one number where a head's tets are a volume mesh, got an array"
            )


def _make_skin(head: LayeredHead, p: Parameters, inside: np.ndarray) -> list[terms.Term]:
    """Make the skin's membrane (Eq. 11) at the vertices `inside`, and its bending where p has one."""
    wrap = head.skin_wrap
    kept = inside[wrap.triangles].any(axis=1)

    def spread(name: str):
        value = spread_to_triangles(name, getattr(p, name), wrap)
        return np.asarray(value)[kept] if np.ndim(value) else value

    triangles = wrap.triangles[kept]
    parts: list[terms.Term] = [terms.SurfaceStrain(triangles, spread("skin_stiffness"), spread("skin_growth"))]
    return parts + ([terms.Bending(triangles, spread("skin_bending"))] if np.any(p.skin_bending) else [])


def _attach(
    head: LayeredHead,
    p: Parameters,
    attached: Sequence[Attachment],
    motion: tuple[Floats, Floats],
    stack: Stack,
    tissue: _Tissue,
    bones: Bones,
) -> tuple[Floats, list[terms.Term]]:
    """Return all vertices, and what holds the attached points; their connecting tets go to `tissue`.

    motion: the skin wrap [mm], each (n, 3), at rest under p and where the expression takes it.
    """
    vertices, n = stack.vertices, len(head.bone)
    bodies: list[terms.Term] = []
    for thing in attached:
        _, tets = connecting_tets(thing.points, head.skull_wrap)
        tets = np.where(tets < n, tets + stack.first_of_skull, tets - n + len(vertices))
        ids = len(vertices) + np.arange(len(thing.points))
        vertices = np.vstack([vertices, thing.points])
        strain = p.connector_ratio * float(np.mean(p.soft_stiffness))
        volume = strain * float(np.mean(p.volume_ratio))
        tissue.add(tets, np.ones(len(tets), dtype=bool), strain, 1.0, volume, 1.0)
        rest = scale_bone(head, p, thing.bone, thing.points)
        if thing.bone == FREE or (thing.bone == MANDIBLE and bones == "rigid"):
            bodies.append(terms.RigidBody(ids, None if thing.bone == FREE else rest))
        elif thing.bone == MANDIBLE:
            rotation, translation = jaw_motion(head, *motion)
            bodies.append(terms.Fixed(ids, rest @ rotation.T + translation))
        else:
            bodies.append(terms.Fixed(ids, rest))
    return vertices, bodies


def _region_mask(head: LayeredHead, region: str | np.ndarray | None) -> np.ndarray:
    """Return a region as a mask over the wraps' vertices, shape (n,); None is the whole head."""
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


def contact_regions(head: LayeredHead) -> tuple[str, ...]:
    """Return the regions of a head that touch as a face moves, for `contact`: of lids, lips and what lines them."""
    return tuple(name for name in CONTACT_REGIONS if name in head.regions)


def contact_triangles(head: LayeredHead, names: Sequence[str | np.ndarray]) -> Ints:
    """Return the skin wrap's triangles within the union of some regions and WIDER edges around it, shape (k, 3)."""
    touching = np.any([_region_mask(head, name) for name in names], axis=0)
    triangles = head.skin_wrap.triangles
    for _ in range(WIDER):
        touching[triangles[touching[triangles].any(axis=1)]] = True
    return triangles[touching[triangles].all(axis=1)]


def check_targets(head: LayeredHead, targets, name: str = "targets") -> Floats:
    """Return targets [mm] of the skin's shape; SceneError, by `name`, for others and as of `check_moved`."""
    words = f"numbers of shape {head.skin.vertices.shape}"
    targets = np.asarray(array_of_kind(name, targets, "fiub", words, error=SceneError), dtype=np.float64)
    if targets.shape != head.skin.vertices.shape:
        raise SceneError(f"{name}: expected the skin's shape {head.skin.vertices.shape}, got {targets.shape}")
    check_moved(name, head.skin, targets, error=SceneError)
    return targets


def _check_choices(bones: str, cells: str, without: Collection[str], attached: Sequence[Attachment]):
    for name, choice, known in (("bones", bones, get_args(Bones)), ("cells", cells, get_args(CellKind))):
        if choice not in known:
            raise SceneError(f"{name} {choice!r}: there are {', '.join(known)}")
    unknown = sorted(set(without) - set(PARTS))
    if isinstance(without, str) or unknown:
        raise SceneError(f"without {without!r}: expected some of {', '.join(PARTS)}")
    if bones == "soft" and any(thing.bone in (CRANIUM, MANDIBLE) for thing in attached):
        raise SceneError("soft bones are the skull wrap itself: attach eyes to it, but no bone")


def apply_law(scene: Scene, law: FaceLaw) -> Scene:
    """Replace each layer's Strain and Volume by a law of the same moduli at rest; PD_ENERGY leaves the scene as it is.

    mu = w_str / 2 and lmbda = w_vol / 3: the linearisation of both energies at rest. A target volume is the law's
    growth, by which tissue is at rest when it has reached it, while Strain holds it back; guards against inversion are
    left out, since a law may be one itself. Raises SceneError for an unknown name, and where a layer has no such
    counterpart: strain limit other than 1, or stiffnesses that vary within a term.
    """
    if law == PD_ENERGY:
        return scene
    if isinstance(law, str):
        laws = LAWS | {name: added.of_moduli for name, added in added_laws().items()}
        if law not in laws:
            raise SceneError(f"law {law!r}: there are {', '.join((PD_ENERGY, *laws))}")
        law = laws[law]
    strains = [strain for strain in scene.of(terms.Strain) if not isinstance(strain, Guard)]
    volumes = scene.of(terms.Volume)
    same = len(strains) == len(volumes)
    if not same or any(
        not np.array_equal(scene.tets_of(strain), scene.tets_of(volume))
        for strain, volume in zip(strains, volumes, strict=True)
    ):
        raise SceneError("apply_law: each Strain term needs a Volume term on the same tets")
    solids: list[terms.Term] = []
    for strain, volume in zip(strains, volumes, strict=True):
        if np.any(strain.limit != 1.0):
            raise SceneError("apply_law: a strain limit other than 1 has no counterpart")
        if np.ptp(strain.stiffness) > 0 or np.ptp(volume.stiffness) > 0:
            raise SceneError("apply_law: stiffnesses that vary within a term are not supported")
        material = law(float(np.max(strain.stiffness)) / 2, float(np.max(volume.stiffness)) / 3)
        solids.append(terms.Hyperelastic(material, tets=strain.tets, growth=volume.target))
    return replace(scene, terms=(*solids, *(t for t in scene.terms if not isinstance(t, (terms.Strain, terms.Volume)))))
