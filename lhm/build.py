"""Build a template: a sphere shrunk onto a skin in an open pose, carried back, and grown inward (SoftDECA 3.1.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from .arkit import ARKIT
from .errors import FitError, InputError
from .files.cache import cached
from .files.template_file import arrays_of, template_from
from .geometry.bvh import TriangleTree
from .identities.space import EYES, MOUTH, OUTSIDE, LinearSpace
from .mesh import Floats, Ints, Surface
from .progress import OnProgress, silent
from .regressor import default_regressor
from .template import DEFAULT_LEVEL, LEVELS, Template
from .wraps import depth, inner
from .wraps.columns import Columns
from .wraps.labels import bone_labels
from .wraps.landmarks import Landmarks, distance_to, landmarks, regions
from .wraps.shrinkwrap import shrink

FORMAT = 12
REST_OPENING = 0.03
"""The share of jawOpen by which the wraps' lips are apart at rest, so that upper and lower lip do not touch."""
SHORTENED = 0.95
MUSCLE = 0.6
"""The muscle wrap lies at this fraction of the way from skin to skull where no muscles are given."""


def template_of(space: LinearSpace, *, level: int = DEFAULT_LEVEL, progress: OnProgress = silent) -> Template:
    """The template of a space's mean head; from the cache, or built and cached."""
    if level not in LEVELS:
        raise InputError(f"level {level}: expected one of {', '.join(map(str, LEVELS))}")
    jaw = space.expressions[ARKIT.index("jawOpen")]
    lids = space.expressions[ARKIT.index("eyeWideLeft")] + space.expressions[ARKIT.index("eyeWideRight")]

    def make():
        return arrays_of(
            build_template(
                space.mean, parts=space.parts, jaw=jaw, lids=lids, level=level, name=space.name, progress=progress
            )
        )

    name = f"template-{space.name}-{space.fingerprint()}-{level}-{FORMAT}"
    template = template_from(cached(name, make))
    return replace(template, regressor=default_regressor(template, space))


def build_template(
    skin: Surface,
    *,
    parts: Ints | None = None,
    jaw: Floats | None = None,
    lids: Floats | None = None,
    level: int = DEFAULT_LEVEL,
    name: str = "custom",
    progress: OnProgress = silent,
) -> Template:
    """A template around a closed skin [mm].

    `parts` (n,): OUTSIDE, MOUTH, EYES or CAP per vertex of the skin; `jaw`, `lids` (n, 3) [mm]: displacements that
    open mouth and lids, so that the wrap can enter them; without, a closed mouth stays closed. Raises FitError,
    naming what failed, if no valid layers could be made.
    """
    x = skin.vertices
    parts = np.full(len(x), OUTSIDE) if parts is None else parts
    jaw, lids = (np.zeros_like(x) if shape is None else shape for shape in (jaw, lids))
    marks = landmarks(skin, parts)
    opened = skin.with_vertices(x + jaw + lids)

    wrap = _wrap(opened, parts, marks, level, progress)
    triangle, wrap_weights, _ = TriangleTree(opened.vertices, opened.triangles).closest(wrap.vertices)
    wrap_ids = opened.triangles[triangle]
    triangle, skin_weights, _ = TriangleTree(wrap.vertices, wrap.triangles).closest(opened.vertices)
    shape = (len(wrap.vertices), len(x))
    wrap_from_skin = _barycentric(wrap_ids, wrap_weights, shape)
    skin_from_wrap = _barycentric(wrap.triangles[triangle], skin_weights, shape[::-1])
    columns = Columns(wrap.triangles, len(wrap.vertices))

    progress("layers", 0.7)
    nearest = wrap_ids[np.arange(len(wrap_ids)), wrap_weights.argmax(axis=1)]
    try:
        rest = inner.uncreased(columns, wrap.vertices - wrap_from_skin @ ((1 - REST_OPENING) * jaw + lids))
        connectors, room = _connectors(columns, rest, parts[nearest], marks)
        stack = inner.valid_layers(columns, np.vstack([rest, rest + MUSCLE * connectors, rest + connectors]))
    except FitError as error:
        raise FitError(f"template {name!r}: {error}") from None
    masks = {region: mask[nearest] for region, mask in regions(skin, parts, marks).items()}
    n = columns.n
    rest, depths = stack[:n], np.linalg.norm(stack[2 * n :] - stack[:n], axis=1)
    # A column that had to be shortened shows that there is less room than the ball inside its skin has.
    room = np.where(depths < SHORTENED * np.linalg.norm(connectors, axis=1), np.minimum(depths, room), room)
    from_lips = distance_to(rest, x[marks.rim])
    bone = bone_labels(rest, rest + wrap_from_skin @ jaw, depths, masks, from_lips, columns.edges)
    progress("layers", 1.0)
    return Template(name, skin, parts, wrap.triangles, stack, room, bone, wrap_from_skin, skin_from_wrap, masks)


def _barycentric(ids: Ints, weights: Floats, shape: tuple[int, int]) -> csr_matrix:
    rows = np.repeat(np.arange(len(ids)), 3)
    return csr_matrix((weights.ravel(), (rows, ids.ravel())), shape=shape)


def _wrap(opened: Surface, parts: Ints, marks: Landmarks, level: int, progress: OnProgress) -> Surface:
    """The sphere shrunk onto the opened skin, denser at lips and lids and in the pockets."""
    x = opened.vertices
    lips, lids = distance_to(x, x[marks.rim]), distance_to(x, x[marks.lids])
    spacing = 1 - 0.6 * np.exp(-((lips / 12.0) ** 2)) - 0.5 * np.exp(-((lids / 10.0) ** 2))
    spacing[parts == MOUTH], spacing[parts == EYES] = 0.4, 0.5
    pockets = (np.minimum(lips, lids) < 8.0) | (parts == MOUTH) | (parts == EYES)

    def part_of_all(what: str, fraction: float) -> None:
        progress(what, 0.7 * fraction)

    return shrink(opened, spacing, pockets, x[marks.rim].mean(axis=0), level=level, progress=part_of_all)


def _connectors(columns: Columns, wrap: Floats, parts: Ints, marks: Landmarks) -> tuple[Floats, Floats]:
    """From skin to skull wrap [mm], shape (n, 3): landmark depths where there is room, smoothed; and the room (n,)."""
    normals = inner.cone_normals(columns, wrap)[0]
    wanted = depth.wanted_depth(wrap, marks.eyes, marks.mouth)
    wanted[parts == MOUTH], wanted[parts == EYES] = depth.LINING, depth.SOCKET
    room = depth.ROOM * depth.inscribed_radius(wrap, normals, 40.0)
    length = np.maximum(np.minimum(wanted, room), depth.LEAST)
    connectors = inner.smoothed(columns, -length[:, None] * normals, 1.0)
    size = np.linalg.norm(connectors, axis=1)
    return connectors * (np.minimum(length, size) / size)[:, None], room
