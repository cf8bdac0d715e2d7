"""The template: three wraps of an identity space's mean head, made once and cached."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix

from .arkit import ARKIT
from .errors import FitError
from .files.cache import cached
from .geometry.bvh import TriangleTree
from .head import LayeredHead
from .identities import Anny
from .identities.space import EYES, MOUTH, LinearSpace
from .mesh import Floats, Ints, Surface
from .progress import OnProgress, silent
from .wraps import depth, inner
from .wraps.labels import bone_labels
from .wraps.landmarks import Landmarks, Mask, distance_to, landmarks, regions
from .wraps.shrinkwrap import neighbours, shrink

FORMAT = 7
REST_OPENING = 0.03
"""The share of jawOpen by which the wraps' lips are apart at rest, so that upper and lower lip do not touch."""


@dataclass(frozen=True, eq=False)
class Template:
    """The mean skin [mm], the wraps over one triangulation, their labels and their ties to the skin.

    `skin`: the mean; `skin_wrap` and `connectors` (n, 3) [mm] to the skull wrap; `bone`, `regions`, `wrap_from_skin`
    and `skin_from_wrap` as in LayeredHead; `marks`: the mean skin's landmarks.
    """

    name: str
    skin: Surface
    skin_wrap: Surface
    connectors: Floats = field(repr=False)
    bone: Ints = field(repr=False)
    wrap_from_skin: csr_matrix = field(repr=False)
    skin_from_wrap: csr_matrix = field(repr=False)
    regions: Mapping[str, Mask] = field(repr=False)
    marks: Landmarks = field(repr=False)

    @property
    def digest(self) -> str:
        """A name for the layers: 12 hexadecimal digits that change with the mean skin, the wraps or the labels."""
        content = hashlib.sha256()
        wrap = self.skin_wrap
        for array in (self.skin.vertices, wrap.vertices, wrap.triangles, self.connectors, self.bone):
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()[:12]

    @property
    def head(self) -> LayeredHead:
        """The mean head itself."""
        return self.layered(self.skin, self.skin_wrap.vertices, self.connectors)

    def layered(self, skin: Surface, wrap: Floats, connectors: Floats) -> LayeredHead:
        """A head of this template's triangulation from its skin, skin wrap and connectors (n, 3) [mm]."""
        muscle, skull = wrap + inner.MUSCLE * connectors, wrap + connectors
        return LayeredHead(
            skin,
            self.skin_wrap.with_vertices(wrap),
            self.skin_wrap.with_vertices(muscle),
            self.skin_wrap.with_vertices(skull),
            self.bone,
            self.wrap_from_skin,
            self.skin_from_wrap,
            self.regions,
        )


def load_template(space: LinearSpace | None = None, *, progress: OnProgress = silent) -> Template:
    """The template of an identity space (default: the embedded head); built on first use (half a minute), then cached.

    Raises FitError, naming what failed, if no valid layers could be made.
    """
    space = Anny() if space is None else space
    arrays = cached(f"template-{space.name}-{space.fingerprint()}-{FORMAT}", lambda: _build(space, progress))
    skin, wrap = space.mean, Surface(arrays["wrap"], arrays["triangles"])
    shape = (len(wrap.vertices), len(skin.vertices))
    return Template(
        space.name,
        skin,
        wrap,
        arrays["connectors"],
        arrays["bone"],
        _barycentric(arrays["wrap_ids"], arrays["wrap_weights"], shape),
        _barycentric(arrays["skin_ids"], arrays["skin_weights"], shape[::-1]),
        {name.removeprefix("region_"): arrays[name] for name in arrays if name.startswith("region_")},
        landmarks(skin, space.parts),
    )


def _barycentric(ids: Ints, weights: Floats, shape: tuple[int, int]) -> csr_matrix:
    rows = np.repeat(np.arange(len(ids)), 3)
    return csr_matrix((weights.ravel(), (rows, ids.ravel())), shape=shape)


def _build(space: LinearSpace, progress: OnProgress) -> dict[str, np.ndarray]:
    skin, parts = space.mean, space.parts
    marks = landmarks(skin, parts)
    jaw = space.expressions[ARKIT.index("jawOpen")]
    wide = space.expressions[ARKIT.index("eyeWideLeft")] + space.expressions[ARKIT.index("eyeWideRight")]
    opened = skin.with_vertices(skin.vertices + jaw + wide)

    wrap = _wrap(opened, parts, marks, progress)
    triangle, wrap_weights, _ = TriangleTree(opened.vertices, opened.triangles).closest(wrap.vertices)
    wrap_ids = opened.triangles[triangle]
    triangle, skin_weights, _ = TriangleTree(wrap.vertices, wrap.triangles).closest(opened.vertices)
    carried = _barycentric(wrap_ids, wrap_weights, (len(wrap.vertices), len(skin.vertices)))
    rest = wrap.with_vertices(wrap.vertices - carried @ ((1 - REST_OPENING) * jaw + wide))
    edges = neighbours(rest.triangles, len(rest.vertices))
    rest = inner.uncreased(rest, edges)

    progress("layers", 0.7)
    nearest = wrap_ids[np.arange(len(wrap_ids)), wrap_weights.argmax(axis=1)]
    normals = inner.cone_normals(rest)
    connectors = _connectors(rest, normals, edges, parts[nearest], marks)
    try:
        rest, connectors = inner.valid_layers(rest, connectors, edges)
    except FitError as error:
        raise FitError(f"template {space.name!r}: {error}") from None
    masks = {name: mask[nearest] for name, mask in regions(skin, parts, marks).items()}
    from_lips = distance_to(rest.vertices, skin.vertices[marks.rim])
    depths = np.linalg.norm(connectors, axis=1)
    bone = bone_labels(rest.vertices, rest.vertices + carried @ jaw, depths, masks, from_lips, edges)
    progress("layers", 1.0)
    return {
        "wrap": rest.vertices,
        "triangles": rest.triangles,
        "connectors": connectors,
        "bone": bone,
        "wrap_ids": wrap_ids,
        "wrap_weights": wrap_weights,
        "skin_ids": wrap.triangles[triangle],
        "skin_weights": skin_weights,
        **{f"region_{name}": mask for name, mask in masks.items()},
    }


def _wrap(opened: Surface, parts: Ints, marks: Landmarks, progress: OnProgress) -> Surface:
    """The sphere shrunk onto the opened skin, denser at lips and lids and in the pockets."""
    x = opened.vertices
    lips, lids = distance_to(x, x[marks.rim]), distance_to(x, x[marks.lids])
    spacing = 1 - 0.6 * np.exp(-((lips / 12.0) ** 2)) - 0.5 * np.exp(-((lids / 10.0) ** 2))
    spacing[parts == MOUTH], spacing[parts == EYES] = 0.4, 0.5
    pockets = (np.minimum(lips, lids) < 8.0) | (parts == MOUTH) | (parts == EYES)

    def part_of_all(what: str, fraction: float) -> None:
        progress(what, 0.7 * fraction)

    return shrink(opened, spacing, pockets, x[marks.rim].mean(axis=0), progress=part_of_all)


def _connectors(wrap: Surface, normals: Floats, edges: csr_matrix, parts: Ints, marks: Landmarks) -> Floats:
    """From skin to skull wrap [mm], shape (n, 3): landmark depths where there is room, smoothed."""
    wanted = depth.wanted_depth(wrap.vertices, marks.eyes, marks.mouth)
    wanted[parts == MOUTH], wanted[parts == EYES] = depth.LINING, depth.SOCKET
    room = depth.ROOM * depth.inscribed_radius(wrap.vertices, normals, 40.0)
    length = np.maximum(np.minimum(wanted, room), depth.LEAST)
    connectors = inner.smoothed(-length[:, None] * normals, edges, 1.0)
    size = np.linalg.norm(connectors, axis=1)
    return connectors * (np.minimum(length, size) / size)[:, None]
