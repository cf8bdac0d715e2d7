"""Requirements of a skin before a head is fitted to it, and of its shapes."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ..base.checks import real
from ..base.errors import InputError, MeshError
from ..base.geometry.likeness import FARTHEST
from ..base.geometry.topology import connected_parts, directed_edges, number_edges
from ..base.mesh import Floats, Ints, Surface
from ..identities.arkit import ARKIT
from ..identities.space import EXTENT

LEAST_EXTENT, GREATEST_EXTENT = EXTENT
FARTHEST_OFF = 10_000.0
"""[mm] Distance from the origin beyond which single precision, as exported files have it, rounds by .001 mm."""
# A thousandth or a tenth of them is a head in metres or centimetres.
_UNITS = {"metres: use unit='m'": 1e-3, "centimetres: use unit='cm'": 0.1}
LEAST_SHAPE = 1.0
"""[mm] Least motion of a vertex in the largest of the 52 shapes: a jaw opens by 40, in metres by .04."""
NEIGHBOURS = 2000
"""How many pairs of neighbours say whether a shape is smooth, about."""
MOST_ROUGH = 0.55
"""Largest difference between neighbours over a shape's size: Anny has 0.12, coarse spheres 0.40, shuffled 0.72."""


def check_skin(surface: Surface) -> None:
    """Raise MeshError unless a skin is one closed, consistently oriented surface of a head's size.

    The message says how many holes there are, which edge has more than two triangles, how many pieces, or what the
    extent [mm] is where the unit seems wrong.
    """
    triangles = surface.triangles
    edges = directed_edges(triangles)
    unique, _, count = number_edges(triangles)
    if (count > 2).any():
        first = unique[count > 2][0]
        raise MeshError(f"skin: {(count > 2).sum()} edges have more than two triangles, the first is {first.tolist()}")
    holes = _pieces(unique[count == 1])
    if holes:
        counted = f"{holes} hole" if holes == 1 else f"{holes} holes"
        raise MeshError(f"skin: the surface is open, with {counted}; it must be closed")
    _check_orientation(edges)
    pieces = _pieces(unique)
    if pieces > 1:
        raise MeshError(f"skin: {pieces} separate pieces; it must be one (leave out eyeballs, teeth and tongue)")
    _check_size(surface)


def _pieces(edges: Ints) -> int:
    used, number = np.unique(edges, return_inverse=True)
    ends = number.reshape(edges.shape)
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(used), len(used)))
    return int(connected_components(graph, directed=False)[0])


def check_registrable(skin: Surface) -> Surface:
    """Check a skin; its largest connected piece over the same vertices, with a warning that counts the pieces.

    It may be open, and have fins. Raises MeshError if it is empty, has neighbours oriented against one another, faces
    inwards (which is what mirroring leaves), or is not of a head's size.
    """
    if not len(skin.triangles):
        raise MeshError("skin: it has no triangles")
    count, piece = connected_parts(skin.triangles, len(skin.vertices))
    of_triangle = piece[skin.triangles[:, 0]]
    kept = of_triangle == np.bincount(of_triangle, weights=skin.areas, minlength=count).argmax()
    pieces = len(np.unique(of_triangle))
    if pieces > 1:
        warnings.warn(f"skin: {pieces} separate pieces; the largest is registered", stacklevel=3)
    whole = Surface(skin.vertices, skin.triangles[kept])
    _, number, times = number_edges(whole.triangles)
    ordinary = (times == 2)[number.ravel()]  # at the edge of a fin no way round is right
    _check_orientation(directed_edges(whole.triangles)[ordinary])
    _check_size(whole)
    check_outward(whole)
    return whole


def _check_orientation(edges: Ints) -> None:
    """Raise MeshError where two triangles run through an edge in one direction."""
    if len(np.unique(edges, axis=0)) != len(edges):
        raise MeshError("skin: neighbouring triangles are oriented against one another")


def check_outward(skin: Surface) -> None:
    """Raise MeshError for a skin whose triangles face inwards, which is what mirroring leaves; it may be open."""
    centres = skin.vertices[skin.triangles].mean(axis=1) - skin.vertices[np.unique(skin.triangles)].mean(axis=0)
    if np.einsum("md,md->", centres, skin.face_normals) <= 0:
        raise MeshError("skin: its triangles face inwards: is it mirrored, or turned inside out?")


def _check_size(skin: Surface) -> None:
    used = skin.vertices[np.unique(skin.triangles)]
    extent = float(np.ptp(used, axis=0).max())
    if LEAST_EXTENT <= extent <= GREATEST_EXTENT:
        off = float(np.abs(used.mean(axis=0)).max())
        if off > FARTHEST_OFF:
            raise MeshError(
                f"skin: it lies {off:.3g} mm from the origin, at most {FARTHEST_OFF:g}; move it there first"
            )
        return
    for unit, factor in _UNITS.items():
        if LEAST_EXTENT * factor <= extent <= GREATEST_EXTENT * factor:
            raise MeshError(f"skin: its extent is {extent:.3g} mm; this looks like {unit}")
    raise MeshError(
        f"skin: its extent is {extent:.4g} mm, a head's lies within {LEAST_EXTENT:g}..{GREATEST_EXTENT:g}: units off?"
    )


def check_shapes(expressions, skin: Surface) -> Floats:
    """Return what the 52 weights add to a skin [mm], shape (52, n, 3).

    InputError for other shapes, and for displacements of another unit or order of vertices.
    """
    shapes = real("expressions", expressions, (len(ARKIT), len(skin.vertices), 3), most=FARTHEST)
    if shapes.dtype == np.float16:  # whose squares are too coarse
        shapes = shapes.astype(np.float32)
    largest = np.abs(shapes).max(axis=(1, 2))
    if 0.0 < largest.max() < LEAST_SHAPE:
        raise InputError(
            f"expressions: the largest moves by {largest.max():.2g} mm, expected at least {LEAST_SHAPE:g}; "
            "are its units off?"
        )
    one, other, _ = skin.triangles[:: max(1, len(skin.triangles) // NEIGHBOURS)].T
    apart = 0.5 * np.mean(np.square(shapes[:, one] - shapes[:, other]), axis=(1, 2))
    rough = np.where(largest >= LEAST_SHAPE, apart / np.maximum(np.mean(np.square(shapes), axis=(1, 2)), 1e-12), 0.0)
    worst = int(rough.argmax())
    if rough[worst] > MOST_ROUGH:
        raise InputError(
            f"expressions: {ARKIT[worst]} moves neighbours apart ({rough[worst]:.2f} of its motion, expected at most "
            f"{MOST_ROUGH:g}); are its vertices in another order?"
        )
    return shapes
