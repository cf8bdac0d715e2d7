"""A surface cut open along a line of given heights: the triangles that it crosses are split, its vertices doubled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from ..base.errors import MeshError
from ..base.mesh import Floats, Ints
from ..wraps.landmarks import Mask

CLEAR = 0.08
"""A cut keeps this share of an edge's length from its ends, so that no triangle is left without width."""
LEAST, WHOLE = 4, 0.8


@dataclass(frozen=True, eq=False)
class Slit:
    """A surface with a slit in it.

    Its vertices are `weights` of the old ones: the old (n,), then those of the cut. `upper` and `lower`: vertices along
    the two sides, from the first end to the last; both ends are in both. `ends` (k, 2) and `shares` (k,) say on which
    old edge each vertex of the cut lies, and where.
    """

    triangles: Ints
    upper: Ints
    lower: Ints
    ends: Ints
    shares: Floats

    def on(self, values: Floats) -> Floats:
        """Values (n, ...) of the old vertices, for all of the new ones."""
        share = self.shares.reshape(-1, *([1] * (values.ndim - 1)))
        return np.concatenate([values, (1 - share) * values[self.ends[:, 0]] + share * values[self.ends[:, 1]]])


def cut_slit(
    triangles: Ints, height: Floats, along: Floats, between: tuple[float, float], allowed: Mask, x: Floats
) -> Slit:
    """Cut a surface where `height` (n,) changes its sign and `along` (n,) lies `between` two values.

    Only triangles with `allowed` (m,) are cut. `x` (n, 3): the vertices. Of several pieces of the line the longest
    counts, and the shortest way from its one end to the other. Raises MeshError where it reaches over less than 0.8 of
    the way, or the surface is too coarse.
    """
    up = height >= 0
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, number = np.unique(sides, axis=0, return_inverse=True)
    number = number.reshape(-1, 3)
    crossed = up[edges[:, 0]] != up[edges[:, 1]]
    share = np.full(len(edges), 0.5)
    a, b = height[edges[crossed, 0]], height[edges[crossed, 1]]
    share[crossed] = np.clip(a / (a - b), CLEAR, 1 - CLEAR)
    place = (1 - share) * along[edges[:, 0]] + share * along[edges[:, 1]]
    crossed &= (place >= between[0]) & (place <= between[1])
    # A crossed triangle has two crossed edges; the way goes from one to the other.
    used = np.flatnonzero(allowed & (crossed[number].sum(axis=1) == 2))
    if len(used) < LEAST:
        raise MeshError("the surface is too coarse there")
    pairs = number[used][crossed[number[used]]].reshape(-1, 2)
    point = (1 - share)[:, None] * x[edges[:, 0]] + share[:, None] * x[edges[:, 1]]
    length = np.linalg.norm(point[pairs[:, 0]] - point[pairs[:, 1]], axis=1)
    graph = coo_matrix((np.maximum(length, 1e-9), tuple(pairs.T)), shape=(len(edges), len(edges))).tocsr()
    count, piece = connected_components(graph, directed=False)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, piece, place)
    np.maximum.at(high, piece, place)
    longest = int((high - low).argmax())
    if (high - low)[longest] < WHOLE * (between[1] - between[0]):
        raise MeshError("the line over the surface is broken")
    nodes = np.flatnonzero(piece == longest)
    begin, end = nodes[place[nodes].argmin()], nodes[place[nodes].argmax()]
    _, before = dijkstra(graph, directed=False, indices=begin, return_predecessors=True)
    way = [int(end)]
    while way[-1] != begin:
        way.append(int(before[way[-1]]))
    return _cut(triangles, up, edges, number, share, np.array(way[::-1]), len(x))


def _cut(triangles: Ints, up: Mask, edges: Ints, number: Ints, share: Floats, path: Ints, n: int) -> Slit:
    k = len(path)
    upper_of = dict(zip(path.tolist(), range(n, n + k), strict=True))
    doubled = path[1:-1]
    lower_of = upper_of | dict(zip(doubled.tolist(), range(n + k, n + 2 * k - 2), strict=True))
    hit = np.isin(number, path)
    out = [triangles[~hit.any(axis=1)]]
    inside = {frozenset(pair) for pair in zip(path[:-1].tolist(), path[1:].tolist(), strict=True)}
    for t in np.flatnonzero(hit.any(axis=1)):
        out.append(np.array(_pieces(triangles[t], number[t].tolist(), up, upper_of, lower_of, inside), dtype=np.int64))
    cut = np.concatenate([path, doubled])
    upper = np.array([upper_of[e] for e in path.tolist()])
    lower = np.array([lower_of[e] for e in path.tolist()])
    return Slit(np.vstack(out), upper, lower, edges[cut], share[cut])


def _pieces(corners: Ints, sides: list[int], up, upper_of, lower_of, inside) -> list[list[int]]:
    """The triangle, split at those of its sides (01, 12, 20) that the cut crosses."""
    at = [side for side in range(3) if sides[side] in upper_of]
    if len(at) == 2 and frozenset(sides[side] for side in at) in inside:
        # Turned so that its sides 01 and 20 are crossed: corner 0 is alone on its side.
        turn = next(c for c in range(3) if c in at and (c + 2) % 3 in at)
        a, b, c = (int(corners[(turn + j) % 3]) for j in range(3))
        p, q = sides[turn], sides[(turn + 2) % 3]
        alone, rest = (upper_of, lower_of) if up[a] else (lower_of, upper_of)
        return [[a, alone[p], alone[q]], [rest[p], b, c], [rest[p], c, rest[q]]]
    pieces = [[int(corner) for corner in corners]]
    for side in at:
        # At an end of the cut both sides are one vertex: the triangle beyond is only split.
        i, j = int(corners[side]), int(corners[(side + 1) % 3])
        new = upper_of[sides[side]]
        for place, piece in enumerate(pieces):
            if i in piece and j in piece:
                third = next(v for v in piece if v not in (i, j))
                pieces[place : place + 1] = [[i, new, third], [new, j, third]]
                break
    return pieces
