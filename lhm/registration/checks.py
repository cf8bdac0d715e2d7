"""What a skin of any topology has to be before a template is registered with it."""

from __future__ import annotations

import warnings

import numpy as np

from ..base.errors import InputError, MeshError
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.topology import connected_parts
from ..base.mesh import Floats, Surface
from ..skin import GREATEST_EXTENT, LEAST_EXTENT
from .landmarks import Pairs
from .start import similarity

# [mm] A head's extent lies within these; a thousandth or a tenth of them is one in metres or centimetres.
_UNITS = {"metres: use unit='m'": 1e-3, "centimetres: use unit='cm'": 0.1}
SCALES = (0.7, 1.5)
FAR = 20.0  # [mm] farther from the skin, or from where the others put it, a landmark is on something else


def registrable(skin: Surface) -> Surface:
    """The skin's largest connected piece over the same vertices; a warning says how many others are left out.

    It may be open. Raises MeshError if it is empty, has edges with more than two triangles or neighbours oriented
    against one another, faces inwards (which is what mirroring leaves), or is not of a head's size.
    """
    if not len(skin.triangles):
        raise MeshError("skin: it has no triangles")
    count, piece = connected_parts(skin.triangles, len(skin.vertices))
    of_triangle = piece[skin.triangles[:, 0]]
    kept = of_triangle == np.bincount(of_triangle, weights=skin.areas, minlength=count).argmax()
    pieces = len(np.unique(of_triangle))
    if pieces > 1:
        warnings.warn(
            f"skin: {pieces} separate pieces; the largest is registered, the others are carried along", stacklevel=3
        )
    whole = Surface(skin.vertices, skin.triangles[kept])
    edges = whole.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    unique, times = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    if (times > 2).any():
        first = unique[times > 2][0].tolist()
        raise MeshError(f"skin: {(times > 2).sum()} edges have more than two triangles, the first is {first}")
    if len(np.unique(edges, axis=0)) != len(edges):
        raise MeshError("skin: neighbouring triangles are oriented against one another")
    _check_size(whole)
    used = skin.vertices[np.unique(whole.triangles)]
    centres = skin.vertices[whole.triangles].mean(axis=1) - used.mean(axis=0)
    if np.einsum("md,md->", centres, whole.face_normals) <= 0:
        raise MeshError("skin: its triangles face inwards: is it mirrored, or turned inside out?")
    return whole


def _check_size(skin: Surface) -> None:
    extent = float(np.ptp(skin.vertices[np.unique(skin.triangles)], axis=0).max())
    if LEAST_EXTENT <= extent <= GREATEST_EXTENT:
        return
    for unit, factor in _UNITS.items():
        if LEAST_EXTENT * factor <= extent <= GREATEST_EXTENT * factor:
            raise MeshError(f"skin: its extent is {extent:.3g} mm; this looks like {unit}")
    raise MeshError(
        f"skin: its extent is {extent:.4g} mm, a head's lies within {LEAST_EXTENT:g}..{GREATEST_EXTENT:g}: units off?"
    )


def check_placed(template: Floats, pairs: Pairs, skin: Surface) -> None:
    """Raise InputError for landmarks that are mirrored, of another scale, off the skin, or that contradict each other.

    `template` (n, 3) [mm] are the template's vertices.
    """
    ids, points = pairs
    rest = template[ids]
    moved, mirrored = similarity(rest, points), similarity(rest * [-1.0, 1.0, 1.0], points)
    off = np.linalg.norm(moved(rest) - points, axis=1)
    as_mirrored = np.linalg.norm(mirrored(rest * [-1.0, 1.0, 1.0]) - points, axis=1)
    if as_mirrored.mean() < 0.5 * off.mean() and off.mean() > 2.0:
        raise InputError(
            f"landmarks: they fit a mirrored head ({as_mirrored.mean():.1f} mm) better than a head "
            f"({off.mean():.1f} mm): are left and right exchanged?"
        )
    if not SCALES[0] <= moved.scale <= SCALES[1]:
        raise InputError(
            f"landmarks: they are those of a head {moved.scale:.3g} times the template's size, "
            f"expected {SCALES[0]:g}..{SCALES[1]:g}: units off?"
        )
    away = TriangleTree(skin.vertices, skin.triangles).closest(points)[2]
    if away.max() > FAR:
        worst = away.argmax()
        raise InputError(
            f"landmarks: that of template vertex {ids[worst]} is {away[worst]:.0f} mm off the skin (at most {FAR:g})"
        )
    if off.max() > 2 * FAR:
        worst = off.argmax()
        raise InputError(
            f"landmarks: that of template vertex {ids[worst]} is {off[worst]:.0f} mm from where the others put it "
            f"(at most {2 * FAR:g})"
        )
