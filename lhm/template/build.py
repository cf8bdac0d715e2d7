"""Build a template: a sphere shrunk onto a skin in an open pose, carried back, and grown inward (SoftDECA 3.1.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np

from ..base.errors import FitError, InputError
from ..base.files.cache import load_or_make
from ..base.files.pack import pack, unpack
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.distance import SignedDistance
from ..base.geometry.mirror import find_twins, symmetrise, symmetrise_weights
from ..base.geometry.rays import first_hits
from ..base.geometry.topology import is_closed
from ..base.geometry.triangles import barycentric_matrix
from ..base.mesh import Floats, Ints, Surface, unit
from ..base.progress import OnProgress, silent
from ..head.columns import Columns
from ..head.head import CRANIUM, FREE
from ..identities import Anny
from ..identities.arkit import ARKIT
from ..identities.space import EYES, MOUTH, OUTSIDE, LinearSpace
from .depths.prior import default_regressor
from .template import DEFAULT_LEVEL, LEVELS, Template
from .wraps import depth, inner
from .wraps.landmarks import (
    Landmarks,
    Mask,
    distance_to,
    find_landmarks,
    find_regions,
    label_bones,
    limit_bones,
)
from .wraps.shrinkwrap import shrink

FORMAT = 19


@dataclass(frozen=True)
class BuildPolicy:
    """Constants of a template's layers."""

    rest_opening: float = 0.03  # of jawOpen, by which the wraps' lips are apart at rest, so that they do not touch
    longest: float = 25.0  # [mm]: bone farther from nose, lids, ear lobes or nape is not what lies under them
    outlier: float = 1.5  # times as long as the rays around it: a ray has slipped past the bone that they met
    pulls: int = 2  # of the skull wrap to the skull
    pull: float = 0.8  # of the way
    shortened: float = 0.95  # of the depth wanted: a column below it shows how much room there is
    muscle: float = 0.6  # of the way from skin to skull, where no muscles are given
    muscle_bounds: tuple[float, float] = (0.35, 0.7)  # of that share where they are: both tissues keep thickness
    longest_ray: float = 45.0  # [mm]
    off_skin: float = 1e-3  # [mm] by which a ray starts inside the wrap, past the triangles that it starts from
    grazing: float = 0.2  # sine of a ray's angle with skin or bone, below which it says nothing about depth
    layers: inner.LayersPolicy = inner.POLICY


POLICY = BuildPolicy()
"""The constants as they were measured; a cached template is made with these."""


class SpaceOptions(TypedDict):
    """An identity space's knowledge of its mean head; see `build_template`."""

    parts: Ints
    jaw: Floats
    lids: Floats


def space_options(space: LinearSpace) -> SpaceOptions:
    """Give `build_template` the mean head's parts, and the expressions that open its mouth and lids."""
    wide = space.expressions[ARKIT.index("eyeWideLeft")] + space.expressions[ARKIT.index("eyeWideRight")]
    return {"parts": space.parts, "jaw": space.expressions[ARKIT.index("jawOpen")], "lids": wide}


def load_template(
    space: LinearSpace | None = None, *, level: int = DEFAULT_LEVEL, progress: OnProgress = silent
) -> Template:
    """Load the template of a space's mean head (default: the embedded head); built on first use, then cached.

    `level` 1, 2 or 3: 1,212, 4,842 or 19,362 vertices per wrap. Raises FitError, naming what failed, if no valid
    layers could be made.
    """
    people = Anny() if space is None else space
    if level not in LEVELS:
        raise InputError(f"level {level}: expected one of {', '.join(map(str, LEVELS))}")

    def make():
        options = space_options(people)
        return dict(pack(build_template(people.mean, **options, level=level, name=people.name, progress=progress)))

    name = f"template-{people.name}-{people.fingerprint()}-{level}-{FORMAT}"
    template = load_or_make(name, make, lambda arrays: unpack(Template, arrays))
    # Depths are published by places of the face; without one they are the template's, stretched.
    regressor = default_regressor(template, people) if "mouth" in template.regions else None
    return replace(template, regressor=regressor, space=people)


def build_template(
    skin: Surface,
    muscles: Surface | None = None,
    skull: Surface | None = None,
    *,
    parts: Ints | None = None,
    jaw: Floats | None = None,
    lids: Floats | None = None,
    bone_of: Callable[[Floats], Ints] | None = None,
    level: int = DEFAULT_LEVEL,
    name: str = "custom",
    policy: BuildPolicy = POLICY,
    progress: OnProgress = silent,
) -> Template:
    """Build a template around a closed skin [mm], over closed surfaces of muscles and skull inside it where given.

    Without `skull` the skull wrap is grown inward by published depths, without `muscles` the muscle wrap lies at a
    fixed share of the way. `parts` (n,): OUTSIDE, MOUTH, EYES or CAP per vertex of the skin; `jaw`, `lids` (n, 3)
    [mm]: displacements that open mouth and lids, so that the wrap can enter them; without, a closed mouth stays
    closed. Where `parts` name no mouth and eyes, no face is known, and tissue without a skull under it is as thick as
    a scalp. `bone_of`: FREE, CRANIUM or MANDIBLE of points (k, 3); default: from how the skin follows `jaw`, and all
    CRANIUM without. `policy` has the constants.

    Raises InputError for surfaces that are not inside one another, FitError, naming what failed, if no valid layers
    could be made.

    A skin that is its own mirror image gets wraps and ties that are; muscles and skull that are not keep the inner
    wraps from it.
    """
    x = skin.vertices
    parts = np.full(len(x), OUTSIDE) if parts is None else parts
    jaw, lids = (np.zeros_like(x) if shape is None else shape for shape in (jaw, lids))
    for inside, what in ((muscles, "muscles"), (skull, "skull")):
        if inside is not None:
            _check_inside(inside, skin, what)
    landmarks = find_landmarks(skin, parts)
    if jaw.any() and not landmarks.known:
        raise InputError("parts: a jaw that opens needs vertices of the mouth's lining and of the eye sockets")
    skin_twins = find_twins(x)
    opened = skin.with_vertices(symmetrise(x + jaw + lids, skin_twins))

    wrap = _wrap(opened, parts, landmarks, level, progress)
    triangle, wrap_weights, _ = TriangleTree(opened.vertices, opened.triangles).closest(wrap.vertices)
    wrap_ids = opened.triangles[triangle]
    triangle, skin_weights, _ = TriangleTree(wrap.vertices, wrap.triangles).closest(opened.vertices)
    shape = (len(wrap.vertices), len(x))
    wrap_from_skin = barycentric_matrix(wrap_ids, wrap_weights, shape)
    skin_from_wrap = barycentric_matrix(wrap.triangles[triangle], skin_weights, shape[::-1])
    nearest = wrap_ids[np.arange(len(wrap_ids)), wrap_weights.argmax(axis=1)]
    masks = {region: mask[nearest] for region, mask in find_regions(skin, parts, landmarks).items()}
    twins = None if skin_twins is None else find_twins(wrap.vertices)
    if skin_twins is not None and twins is not None:
        wrap_from_skin = symmetrise_weights(wrap_from_skin, twins, skin_twins)
        skin_from_wrap = symmetrise_weights(skin_from_wrap, skin_twins, twins)
        masks = {region: mask | mask[twins] for region, mask in masks.items()}
    inside_mirrors = all(inside is None or find_twins(inside.vertices) is not None for inside in (muscles, skull))
    columns = Columns(wrap.triangles, len(wrap.vertices), twins if inside_mirrors else None)

    progress("layers", 0.7)
    try:
        closed = wrap.vertices - wrap_from_skin @ ((1 - policy.rest_opening) * jaw + lids)
        rest = inner.smooth_creases(columns, closed, policy.layers)
        wanted = _find_wanted(columns, rest, parts[nearest], landmarks, muscles, skull, policy)
        stack = inner.make_valid(columns, wanted.stack(rest, rest + wanted.connectors), policy.layers)
        for _ in range(policy.pulls):
            if skull is None:
                break
            stack = inner.make_valid(columns, _pull(columns, stack, wanted, skull, policy.pull), policy.layers)
    except FitError as error:
        raise FitError(f"template {name!r}: {error}") from None
    rest, depths = stack[: columns.n], np.linalg.norm(stack[2 * columns.n :] - stack[: columns.n], axis=1)
    # A column that ended shorter than wanted shows that there is less room than the ball inside its skin has.
    room = np.where(depths < policy.shortened * wanted.depth, np.minimum(depths, wanted.room), wanted.room)
    opened_wrap, from_lips = rest + wrap_from_skin @ jaw, distance_to(rest, x[landmarks.rim])
    skull_wrap = stack[2 * columns.n :]
    if not landmarks.known:
        bone = np.full(columns.n, CRANIUM) if bone_of is None else bone_of(skull_wrap)
    elif bone_of is None:
        bone = label_bones(rest, opened_wrap, depths, masks, from_lips, columns.edges)
    else:
        bone = limit_bones(bone_of(skull_wrap), rest, opened_wrap, depths, masks, from_lips)
    if columns.twins is not None:
        room = 0.5 * (room + room[columns.twins])
        bone = np.where(bone == bone[columns.twins], bone, FREE)
    progress("layers", 1.0)
    ties = (wrap_from_skin, skin_from_wrap)
    skull_bone = None if bone_of is None or skull is None else bone_of(skull.vertices)
    return Template(
        name, skin, parts, wrap.triangles, stack, room, bone, *ties, masks, muscles, skull, skull_bone=skull_bone
    )


def _check_inside(inside: Surface, skin: Surface, what: str) -> None:
    if not is_closed(inside.triangles):
        raise InputError(f"{what}: the surface is open or not consistently oriented; it has to be closed")
    outside = SignedDistance(skin)(inside.vertices)[0]
    if outside.max() > 0:
        raise InputError(
            f"{what}: {np.count_nonzero(outside > 0)} of {len(outside)} vertices lie outside the skin, the farthest "
            f"by {outside.max():.3g} mm (none may)"
        )


def _wrap(opened: Surface, parts: Ints, landmarks: Landmarks, level: int, progress: OnProgress) -> Surface:
    """The sphere shrunk onto the opened skin, denser at lips and lids and in the pockets."""
    x = opened.vertices
    lips, lids = distance_to(x, x[landmarks.rim]), distance_to(x, x[landmarks.lids])
    spacing = 1 - 0.6 * np.exp(-((lips / 12.0) ** 2)) - 0.5 * np.exp(-((lids / 10.0) ** 2))
    spacing[parts == MOUTH], spacing[parts == EYES] = 0.4, 0.5
    pockets = (np.minimum(lips, lids) < 8.0) | (parts == MOUTH) | (parts == EYES)

    def part_of_all(what: str, fraction: float) -> None:
        progress(what, 0.7 * fraction)

    focus = x[landmarks.rim].mean(axis=0) if landmarks.known else x[x[:, 2].argmax()]
    return shrink(opened, spacing, pockets, focus, level=level, progress=part_of_all)


@dataclass(frozen=True, eq=False)
class _Wanted:
    """Places that the inner wraps should have.

    `connectors` (n, 3) [mm] from skin to skull wrap; the muscle wrap's `share` of the way, `depth` and `room` [mm] and
    whether the skull wrap is to lie on a given skull, all (n,).
    """

    connectors: Floats
    share: Floats
    depth: Floats
    room: Floats
    on_skull: Mask

    def stack(self, skin: Floats, skull: Floats) -> Floats:
        """Stack the wraps (3 n, 3) [mm] over a skin and a skull wrap."""
        return np.vstack([skin, skin + self.share[:, None] * (skull - skin), skull])


def _find_wanted(
    columns: Columns,
    wrap: Floats,
    parts: Ints,
    landmarks: Landmarks,
    muscles: Surface | None,
    skull: Surface | None,
    policy: BuildPolicy,
) -> _Wanted:
    """Published depths where there is room, smoothed; where a ray from the wrap meets the skull, its distance."""
    normals = inner.cone_normals(columns, wrap)[0]
    if landmarks.known:
        length = depth.mean_depth(wrap, landmarks.eyes, landmarks.mouth)
    else:
        length = np.full(columns.n, depth.SCALP)
    length[parts == MOUTH], length[parts == EYES] = depth.LINING, depth.SOCKET
    room = depth.ROOM * depth.inscribed_radius(wrap, normals, 40.0)
    met, on_skull, smoothing = np.zeros_like(wrap), np.zeros(columns.n, bool), 1.0
    if skull is not None:
        directions = unit(inner.smooth(columns, -normals, 4.0))
        met, on_skull = find_connectors(
            columns.surface(wrap), normals, directions, skull, longest=policy.longest, policy=policy
        )
        reach = np.linalg.norm(met, axis=1)
        on_skull = on_skull & ~(reach > policy.outlier * _middle_around(columns, np.where(on_skull, reach, length)))
        # A ray that meets bone shows that there is room up to it.
        length[on_skull] = room[on_skull] = reach[on_skull]
        smoothing = 0.2
    wanted = length
    length = np.maximum(np.minimum(length, room), depth.LEAST)
    connectors = inner.smooth(columns, np.where(on_skull[:, None], met, -length[:, None] * normals), smoothing)
    size = np.linalg.norm(connectors, axis=1)
    connectors *= (np.minimum(length, size) / size)[:, None]
    share = np.full(columns.n, policy.muscle)
    if muscles is not None:
        met, on_muscle = find_connectors(columns.surface(wrap), normals, unit(connectors), muscles, policy=policy)
        reach = np.linalg.norm(met[on_muscle], axis=1) / np.linalg.norm(connectors[on_muscle], axis=1)
        share[on_muscle] = np.clip(reach, *policy.muscle_bounds)
        share = inner.smooth(columns, share[:, None], 0.5)[:, 0]
    return _Wanted(connectors, share, wanted, room, on_skull)


def _pull(columns: Columns, stack: Floats, wanted: _Wanted, skull: Surface, share: float) -> Floats:
    """The wraps with the skull wrap a share of the way to the closest point of the skull, where it is to lie on it."""
    x = stack[2 * columns.n :]
    triangle, weights, _ = TriangleTree(skull.vertices, skull.triangles).closest(x)
    closest = np.einsum("kc,kcd->kd", weights, skull.vertices[skull.triangles[triangle]])
    return wanted.stack(stack[: columns.n], x + np.where(wanted.on_skull[:, None], share * (closest - x), 0.0))


def _middle_around(columns: Columns, values: Floats) -> Floats:
    """The median of each vertex's own value and its neighbours', shape (n,)."""
    starts, others = columns.edges.indptr, columns.edges.indices
    return np.array([np.median([values[v], *values[others[starts[v] : starts[v + 1]]]]) for v in range(columns.n)])


def find_connectors(
    skin_wrap: Surface,
    normals: Floats,
    directions: Floats,
    surface: Surface,
    *,
    longest: float | None = None,
    policy: BuildPolicy = POLICY,
) -> tuple[Floats, Mask]:
    """Find connectors (n, 3) [mm] from a closed skin wrap to a closed surface inside it, and where there are any.

    A ray goes along the unit `directions` (n, 3), and where that fails against the outward unit `normals` (n, 3). Found
    is what enters `surface` from outside within `longest` [mm], by default `policy.longest_ray`. The ray may neither
    graze it nor the wrap, nor leave the wrap before: not so over the mouth's bag, in eye sockets, ears, or over a neck
    without bone. NaN elsewhere.
    """
    longest = policy.longest_ray if longest is None else longest
    bone = TriangleTree(surface.vertices, surface.triangles)
    skin = TriangleTree(skin_wrap.vertices, skin_wrap.triangles)
    faces = unit(surface.face_normals)
    connectors = np.full_like(skin_wrap.vertices, np.nan)
    for way in (directions, -normals):
        missing = np.flatnonzero(np.isnan(connectors[:, 0]))
        ray, start = way[missing], skin_wrap.vertices[missing] + policy.off_skin * way[missing]
        triangle, distance = first_hits(bone, start, ray, longest)
        leaves = first_hits(skin, start, ray, longest)[1]
        enters = -np.einsum("kd,kd->k", faces[triangle], ray) > policy.grazing
        inward = -np.einsum("kd,kd->k", normals[missing], ray) > policy.grazing
        good = (triangle >= 0) & enters & inward & (distance < leaves)
        connectors[missing[good]] = (distance[good] + policy.off_skin)[:, None] * ray[good]
    return connectors, ~np.isnan(connectors[:, 0])
