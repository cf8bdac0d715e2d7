"""Whether mouth and eyes are open: ways along a wrap from lip to lip."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from ..base.geometry.topology import directed_edges
from ..base.mesh import Floats, Ints
from .columns import edge_graph

OPEN, BLINK = ("jawOpen",), ("eyeBlinkLeft", "eyeBlinkRight")


def lip_path(vertices: Floats, triangles: Ints, regions: Mapping[str, NDArray[np.bool_]]) -> float | None:
    """Measure the shortest way [mm] along the wrap's edges from the middle of one lip to that of the other.

    The farthest from one another, along the wrap, of the vertices next to the mouth's lining and within 6 mm of its
    middle: on one lip at most some 15 mm, from lip to lip much more, for the way runs through the lining or around
    the mouth's corner; unless the wrap bridges the lips. Which lip is which need not be known, however they curve.
    Zero if no vertex of the wrap lies in the mouth; None for a wrap without the region "mouth".
    """
    if "mouth" not in regions:
        return None
    ring = _ring(triangles, regions["mouth"])
    if not ring.size:
        return 0.0
    vertices = turn_upright(vertices, regions)
    x = vertices[ring, 0]
    middle = ring[np.abs(x - 0.5 * (x.min() + x.max())) < 6.0]  # [mm]
    return float(_ways(vertices, triangles, middle[:1])[middle].max(initial=0.0)) if middle.size else 0.0


def lid_path(
    vertices: Floats, triangles: Ints, regions: Mapping[str, NDArray[np.bool_]]
) -> tuple[float, float] | tuple[None, None]:
    """Measure the shortest way [mm] along the wrap's edges from upper to lower lid, and that over the straight one.

    From the middle of the upper to that of the lower half of the ring around each socket; the eye with the smaller
    ratio counts. It runs through the socket or around the eye's corner (a ratio of pi / 2 for a round eye), and the
    ratio is near one only where a wrap bridges the lids. Zeros if no vertex lies in one of the sockets, None for a
    wrap without the region "eyes".
    """
    if "eyes" not in regions:
        return None, None
    eyes = np.asarray(regions["eyes"], dtype=bool)
    if not eyes.any():
        return 0.0, 0.0
    vertices = turn_upright(vertices, regions)
    x = vertices[:, 0]
    middle = 0.5 * (x[eyes].min() + x[eyes].max())
    paths = [_lids(vertices, triangles, eyes & side) for side in (x > middle, x <= middle)]
    return min(paths, key=lambda pair: pair[1])


def turn_upright(vertices: Floats, regions: Mapping[str, NDArray[np.bool_]]) -> Floats:
    """Turn points (n, 3) [mm] into the face's own axes by its regions; as they are where a region is missing."""
    axes = find_face_axes(vertices, regions)
    return vertices if axes is None else (vertices - axes[0]) @ axes[1]


def find_face_axes(vertices: Floats, regions: Mapping[str, NDArray[np.bool_]]) -> tuple[Floats, Floats] | None:
    """Find the point between the eyes (3,) [mm], and the face's axes as columns (3, 3): to its left, up, out.

    Up is from mouth to eyes. None where the wrap's vertices (n, 3) [mm] have no region "mouth" or "eyes".
    """
    mouth, eyes = (np.asarray(regions.get(name, []), dtype=bool) for name in ("mouth", "eyes"))
    if not mouth.any() or not eyes.any():
        return None
    sockets = vertices[eyes]
    middle = sockets.mean(axis=0)
    across = np.linalg.svd(sockets - middle, full_matrices=False)[2][0]
    # The eyes' midpoint halves their extent, however many vertices each of them has.
    reach = (sockets - middle) @ across
    middle = middle + 0.5 * (reach.min() + reach.max()) * across
    up = middle - vertices[mouth].mean(axis=0)
    up = up - (up @ across) * across
    up = up / max(float(np.linalg.norm(up)), 1e-30)
    out = np.cross(across, up)
    side = 1.0 if out @ (middle - vertices.mean(axis=0)) >= 0 else -1.0
    return middle, np.stack([side * across, up, side * out], axis=1)


def _lids(vertices: Floats, triangles: Ints, socket: NDArray[np.bool_]) -> tuple[float, float]:
    ring = _ring(triangles, socket)
    if not ring.size:
        return 0.0, 0.0
    centre = 0.5 * (vertices[ring].min(axis=0) + vertices[ring].max(axis=0))
    ring = ring[np.argsort(np.abs(vertices[ring, 0] - centre[0]), kind="stable")]
    above = vertices[ring, 1] > centre[1]
    upper, lower = ring[above][:1], ring[~above][:1]
    if not upper.size or not lower.size:
        return 0.0, 0.0
    way = float(_ways(vertices, triangles, upper)[lower][0])
    return way, way / max(float(np.linalg.norm(vertices[upper] - vertices[lower])), 1e-9)


def _ring(triangles: Ints, inside: NDArray[np.bool_]) -> Ints:
    """The vertices outside a region that have a neighbour in it."""
    edges = directed_edges(triangles)
    ring = np.unique(edges[inside[edges].sum(axis=1) == 1])
    return ring[~inside[ring]]


def _ways(vertices: Floats, triangles: Ints, start: Ints) -> Floats:
    """Length [mm] of the shortest way along edges from `start` to every vertex, shape (n,)."""
    return dijkstra(edge_graph(vertices, triangles), directed=False, indices=start, min_only=True)
