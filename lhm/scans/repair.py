"""Make one oriented surface of a mesh as files have them, and say what was changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from ..base.errors import MeshError
from ..base.files.surface_file import Scan
from ..base.geometry.topology import connected_parts, number_edges, open_edges
from ..base.mesh import Floats, Ints

SAME = 1e-6
"""Vertices closer than this share of the mesh's extent are one, if both lie on open edges."""
HAIR = 1e-12
"""Triangles of less than this share of the largest extent squared have no area."""

TRIED, LEAST_PIECE = 3, 0.01
"""So many pieces may be the head, of at least this share of the largest one's size."""


@dataclass(frozen=True, eq=False)
class Repaired:
    """A scan that is one piece, and what was done."""

    scan: Scan
    notes: tuple[str, ...] = ()


def repair_scan(scan: Scan) -> Repaired:
    """Make the main piece of a scan one oriented surface, open or closed, that closest points can be found on.

    In turns: vertices that lie upon one another on open edges (the seams of textures) become one; triangles without
    area and doubles go; neighbours are turned the same way round, and all of them outwards; of several pieces the main
    one is kept: the one that moves most in the morph targets, or else the one that encloses most. Openings stay. Raises
    MeshError if nothing is left.
    """
    return next(repair_pieces(scan))


def repair_pieces(scan: Scan) -> Iterator[Repaired]:
    """Yield what `repair_scan` makes of the main piece, and then of the next ones, at most TRIED of them.

    A plate or a backdrop encloses next to nothing; a stand, hair or clothes may enclose more than a head.
    """
    notes: list[str] = []
    for step in (_merge, _sound, _orient):
        scan = step(scan, notes)
    for piece, note in _pieces(scan):
        remarks = [*notes, note] if note else [*notes]
        yield Repaired(_outwards(piece, remarks), tuple(remarks))


def _merge(scan: Scan, notes: list[str]) -> Scan:
    rim = np.unique(open_edges(scan.triangles))
    if not len(rim):
        return scan
    # Lips that touch at rest may not be sewn together: what moves apart is told apart by the morph targets.
    places = np.hstack([scan.vertices[rim], *(delta[rim] for delta in scan.morphs.values())])
    pairs = cKDTree(places).query_pairs(SAME * max(_extent(scan), 1e-30), output_type="ndarray")
    if not len(pairs):
        return scan
    n = len(scan.vertices)
    joined = coo_matrix((np.ones(len(pairs)), (rim[pairs[:, 0]], rim[pairs[:, 1]])), shape=(n, n))
    _, label = connected_components(joined, directed=False)
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    notes.append(f"{n - len(first)} vertices that lie on others at seams were merged with them")
    return _over(scan, first, number.ravel()[scan.triangles])


def _sound(scan: Scan, notes: list[str]) -> Scan:
    triangles = scan.triangles
    a, b, c = (scan.vertices[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1) & (area > HAIR * _extent(scan) ** 2)
    _, once = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    single = np.zeros(len(triangles), bool)
    single[once] = True
    kept = distinct & single
    if not kept.any():
        raise MeshError("skin: none of its triangles has an area")
    if not distinct.all():
        notes.append(f"{(~distinct).sum()} triangles without area were dropped")
    if doubles := np.count_nonzero(distinct & ~single):
        notes.append(f"{doubles} doubled triangles were dropped")
    return replace(scan, triangles=triangles[kept])


def _orient(scan: Scan, notes: list[str]) -> Scan:
    triangles = scan.triangles
    m = len(triangles)
    left, right, ends = _neighbours(triangles)
    # Neighbours agree if they run through their edge in opposite directions.
    against = _forward(triangles[left], ends) == _forward(triangles[right], ends)
    if not against.any():
        return scan
    graph = coo_matrix((np.where(against, 2.0, 1.0), (left, right)), shape=(m, m)).tocsr()
    graph = graph + graph.T
    _, piece = connected_components(graph, directed=False)
    turned = np.zeros(m, bool)
    for first in np.unique(piece, return_index=True)[1]:
        order, before = breadth_first_order(graph, first, directed=False)
        for triangle in order[1:]:
            turned[triangle] = turned[before[triangle]] ^ (graph[before[triangle], triangle] == 2.0)
        members = piece == piece[first]
        if turned[members].sum() > 0.5 * members.sum():
            turned[members] = ~turned[members]
    turned_back = np.where(turned[:, None], triangles[:, ::-1], triangles)
    if (_forward(turned_back[left], ends) == _forward(turned_back[right], ends)).any():
        raise MeshError("skin: its surface has one side only, like a Moebius strip; it cannot be a head's")
    notes.append(f"{turned.sum()} triangles were turned the way round of their neighbours")
    return replace(scan, triangles=turned_back)


def _pieces(scan: Scan) -> Iterator[tuple[Scan, str]]:
    """Yield separate pieces, the main one first, and what is remarks of the others."""
    count, part = connected_parts(scan.triangles, len(scan.vertices))
    of_triangle = part[scan.triangles[:, 0]]
    pieces = len(np.unique(of_triangle))
    if pieces == 1:
        yield _drop_unused(scan), ""
        return
    motion = sum((np.linalg.norm(delta, axis=1) for delta in scan.morphs.values()), np.zeros(len(scan.vertices)))
    a, b, c = (scan.vertices[scan.triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if motion.any():
        moved = area * motion[scan.triangles].mean(axis=1)
        order = [np.bincount(of_triangle, weights=moved, minlength=count).argmax()]
        how = "one that the morph targets move most"
    else:
        size = _measure_enclosed(np.stack([a, b, c], axis=1), area, of_triangle, count)
        order = [k for k in np.argsort(-size, kind="stable")[:TRIED] if size[k] >= LEAST_PIECE * size.max()]
        how = "largest"
    for rank, chosen in enumerate(order):
        kept = of_triangle == chosen
        left_out = f"{np.count_nonzero(~kept)} triangles (eyes, teeth, hair ...?) are left out"
        found = how if rank == 0 else "one that a face was found in"
        yield (
            _drop_unused(replace(scan, triangles=scan.triangles[kept])),
            f"of {pieces} separate pieces the {found} was kept; {left_out}",
        )


def _measure_enclosed(corners: Floats, area: Floats, part: Ints, count: int) -> Floats:
    """Return an area (count,) for each part: of a cube of the volume between its triangles and their middle."""
    whole = np.maximum(np.bincount(part, weights=area, minlength=count), 1e-300)
    centres = corners.mean(axis=1)
    middle = np.stack(
        [np.bincount(part, weights=area * centres[:, axis], minlength=count) for axis in range(3)], axis=1
    )
    a, b, c = (corners - (middle / whole[:, None])[part][:, None]).transpose(1, 0, 2)
    volume = np.abs(np.bincount(part, weights=np.einsum("md,md->m", a, np.cross(b, c)), minlength=count))
    return volume ** (2.0 / 3.0)


def _drop_unused(scan: Scan) -> Scan:
    """Drop the vertices that no triangle has."""
    used, number = np.unique(scan.triangles, return_inverse=True)
    return scan if len(used) == len(scan.vertices) else _over(scan, used, number.reshape(-1, 3))


def _outwards(scan: Scan, notes: list[str]) -> Scan:
    a, b, c = (scan.vertices[scan.triangles[:, k]] - scan.vertices.mean(axis=0) for k in range(3))
    if np.einsum("md,md->", a + b + c, np.cross(b - a, c - a)) >= 0:
        return scan
    notes.append("its triangles faced inwards and were turned round")
    return replace(scan, triangles=scan.triangles[:, ::-1])


def _over(scan: Scan, ids: Ints, triangles: Ints) -> Scan:
    """A scan over some of its vertices."""
    morphs: Mapping[str, Floats] = {name: delta[ids] for name, delta in scan.morphs.items()}
    return replace(scan, vertices=scan.vertices[ids], triangles=triangles, morphs=morphs, shown={})


def _extent(scan: Scan) -> float:
    return float(np.ptp(scan.vertices[np.unique(scan.triangles)], axis=0).max())


def _neighbours(triangles: Ints) -> tuple[Ints, Ints, Ints]:
    """The two triangles at each edge that has two, shape (k,) each, and its ends (k, 2)."""
    edges, number, times = number_edges(triangles)
    number = number.ravel()
    order = np.argsort(number, kind="stable")
    order = order[times[number[order]] == 2]
    return order[::2] // 3, order[1::2] // 3, edges[number[order[::2]]]


def _forward(triangles: Ints, ends: Ints) -> np.ndarray:
    """Whether each triangle runs from its edge's first end to the second."""
    place = (triangles == ends[:, :1]).argmax(axis=1)
    return triangles[np.arange(len(triangles)), (place + 1) % 3] == ends[:, 1]
