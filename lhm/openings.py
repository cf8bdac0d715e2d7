"""Whether mouth and eyes are open in a wrap: the way along it from upper to lower lip, and from lid to lid."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from .mesh import Floats, Ints

LIP_MIDDLE = 6.0
LIP_GAP = 3.0


def lip_path(vertices: Floats, triangles: Ints, regions: Mapping[str, NDArray[np.bool_]]) -> float | None:
    """Shortest way [mm] along the wrap's edges from the middle of the upper lip to that of the lower lip.

    It runs through the mouth's lining or around its corner, and is short only where a wrap bridges the lips. Zero if
    no vertex of the wrap lies on the lips or in the mouth; None for a wrap without the regions "lips" and "mouth".
    """
    if "lips" not in regions or "mouth" not in regions:
        return None
    lips = np.flatnonzero(regions["lips"])
    if not lips.size or not np.any(regions["mouth"]):
        return 0.0
    centre = np.median(vertices[lips], axis=0)
    middle = lips[np.abs(vertices[lips, 0] - centre[0]) < LIP_MIDDLE]
    # Of the lips' middle the rows next to the line between them face each other across the gap.
    upper = middle[vertices[middle, 1] > centre[1] + LIP_GAP]
    lower = middle[vertices[middle, 1] < centre[1] - LIP_GAP]
    return _way(vertices, triangles, upper, lower)


def lid_path(
    vertices: Floats, triangles: Ints, regions: Mapping[str, NDArray[np.bool_]]
) -> tuple[float, float] | tuple[None, None]:
    """Shortest way [mm] along the wrap's edges from upper to lower lid, and the same over the straight distance.

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
    x = vertices[:, 0]
    middle = 0.5 * (x[eyes].min() + x[eyes].max())
    found = [_lids(vertices, triangles, eyes & side) for side in (x > middle, x <= middle)]
    return min(found, key=lambda pair: pair[1])


def _lids(vertices: Floats, triangles: Ints, socket: NDArray[np.bool_]) -> tuple[float, float]:
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ring = np.unique(edges[socket[edges].sum(axis=1) == 1])
    ring = ring[~socket[ring]]
    if not ring.size:
        return 0.0, 0.0
    centre = 0.5 * (vertices[ring].min(axis=0) + vertices[ring].max(axis=0))
    ring = ring[np.argsort(np.abs(vertices[ring, 0] - centre[0]), kind="stable")]
    above = vertices[ring, 1] > centre[1]
    upper, lower = ring[above][:1], ring[~above][:1]
    way = _way(vertices, triangles, upper, lower)
    return way, way / max(float(np.linalg.norm(vertices[upper] - vertices[lower])), 1e-9)


def _way(vertices: Floats, triangles: Ints, start: Ints, end: Ints) -> float:
    """Length [mm] of the shortest way along edges between two sets of vertices; 0 if one is empty."""
    if not start.size or not end.size:
        return 0.0
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    # The two triangles at an edge name it in opposite directions, so no entry is there twice to be summed.
    graph = csr_matrix((np.maximum(length, 1e-9), edges.T), shape=(len(vertices), len(vertices)))
    return float(dijkstra(graph, directed=False, indices=start, min_only=True)[end].min())
