"""Surfaces that must not cross themselves or obstacles, the rows of what is near, and how far a step may go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ....lhm.base.geometry.bvh import BoxTree, TriangleTree
from ....lhm.base.geometry.topology import unique_edges
from ....lhm.base.mesh import Floats, Ints, Surface
from ...scene import Scene
from ...terms import Contact
from ..policy import ContactPolicy
from ..terms.gaps import find_shares
from .pairs import find_free_share, measure_near
from .points import ContactPoints
from .rows import Rows

AHEAD = 1.5
"""Multiple of the offset within which pairs are rows at least."""
LEAST = 1e-9
"""[mm] An offset of pairs that touch or cross at rest, below which nothing pushes them."""


@dataclass(frozen=True, eq=False)
class Elements:
    """Triangles (m, 3), edges (e, 2) and vertices (v,) of a surface, by numbers of contact points, and their trees."""

    triangles: Ints
    edges: Ints
    vertices: Ints
    of_triangles: BoxTree
    of_edges: BoxTree

    @classmethod
    def from_triangles(cls, triangles: Ints, rest: Floats) -> Elements:
        """Take the elements of triangles; rest [mm], shape (k, 3), are all contact points."""
        edges = unique_edges(triangles)
        trees = (BoxTree(enclose(each, rest, rest), each) for each in (triangles, edges))
        return cls(triangles, edges, np.unique(triangles), *trees)

    def moved(self, low: Floats, high: Floats) -> Elements:
        """Return the same elements with trees of boxes about points in boxes low to high (k, 3) [mm]."""
        trees = (tree.moved(enclose(tree.ids, low, high)) for tree in (self.of_triangles, self.of_edges))
        return Elements(self.triangles, self.edges, self.vertices, *trees)

    def meet_vertices(self, other: Elements, low: Floats, high: Floats) -> Ints:
        """Pair vertices of another surface, in their boxes, with triangles, shape (r, 4)."""
        vertices = other.vertices[:, None]
        ends = self.of_triangles.overlaps(enclose(vertices, low, high), vertices)
        return np.hstack([vertices[ends[:, 0]], self.triangles[ends[:, 1]]])


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """The surface of a Contact term, which meets itself and its obstacles: their elements, None where it has none.

    rest (k, 3) [mm] are all contact points at rest, areas (k,) [mm²] its own about each, 0 at obstacles; offset [mm] is
    the distance below which it pushes, unless a pair is nearer at rest; stiffness [kPa/mm].
    """

    own: Elements
    others: Elements | None
    rest: Floats
    areas: Floats
    offset: float
    stiffness: float

    @classmethod
    def from_scene(cls, scene: Scene, points: ContactPoints, policy: ContactPolicy) -> tuple[ContactSurface, ...]:
        """Make the surfaces of a scene over its contact points."""
        rest, first = points.find_places(scene.vertices), len(points.vertices)
        surfaces = []
        for term in scene.of(Contact):
            triangles = [np.searchsorted(points.vertices, term.triangles)]
            for obstacle in term.obstacles:
                triangles.append(first + obstacle.surface.triangles)
                first += len(obstacle.surface.vertices)
            own, others = Elements.from_triangles(triangles[0], rest), None
            if term.obstacles:
                others = Elements.from_triangles(np.vstack(triangles[1:]), rest)
            areas = Surface(rest, triangles[0]).vertex_areas
            surfaces.append(cls(own, others, rest, areas, term.thickness + policy.offset, term.stiffness))
        return tuple(surfaces)

    def weigh(self, ids: Ints, between_edges: np.ndarray) -> Floats:
        """Return the area [mm²] that each pair (r, 4) stands for, (r,): its vertex' or, of own corners, the mean.

        Obstacles have none, so that their points weigh as much as the surface that they meet.
        """
        areas = self.areas[ids]
        means = areas.sum(axis=1) / np.count_nonzero(areas, axis=1)
        return np.where(between_edges | (areas[:, 0] == 0.0), means, areas[:, 0])

    @cached_property
    def has_close_pairs(self) -> bool:
        """Whether some pairs are nearer at rest than the offset."""
        return bool(len(self.find_near(self.offset)))

    def find_near(self, reach: float) -> Ints:
        """Find the pairs, shape (r, 4), that are nearer than `reach` [mm] at rest."""
        pairs, of_vertices = self.find_candidates(self.rest, self.rest, reach)
        return pairs[measure_near(self.rest, pairs, of_vertices, reach)[0]]

    def count_crossings(self, x: Floats) -> int:
        """Count the pairs of triangles that cross with contact points at x (k, 3) [mm]."""
        tree = TriangleTree(x, self.own.triangles)
        crossings = len(tree.self_crossings())
        if self.others is not None:
            crossings += len(tree.crossings(TriangleTree(x, self.others.triangles)))
        return crossings

    def find_candidates(self, low: Floats, high: Floats, reach: float) -> tuple[Ints, int]:
        """Find the pairs (r, 4) that may come within `reach` [mm] while each point stays in its box.

        low, high (k, 3): the boxes' ends [mm]. Also returns how many pairs, the first, are of vertices and triangles.
        """
        low, high = low - 0.5 * reach, high + 0.5 * reach
        own = self.own.moved(low, high)
        of_vertices = [own.meet_vertices(own, low, high)]
        sides = own.of_edges.self_overlaps()
        between_edges = [np.hstack([own.edges[sides[:, 0]], own.edges[sides[:, 1]]])]
        if self.others is not None:
            others = self.others.moved(low, high)
            of_vertices += [own.meet_vertices(others, low, high), others.meet_vertices(own, low, high)]
            sides = others.of_edges.overlaps(own.of_edges.boxes, own.edges)
            between_edges.append(np.hstack([own.edges[sides[:, 0]], others.edges[sides[:, 1]]]))
        pairs = np.vstack([*of_vertices, *between_edges])
        return pairs, sum(map(len, of_vertices))


def enclose(elements: Ints, low: Floats, high: Floats) -> Floats:
    """Return boxes (m, 6) about elements (m, any) of vertices in boxes low to high (k, 3)."""
    return np.hstack([low[elements].min(axis=1), high[elements].max(axis=1)])


class Nearby:
    """Finds what is near on surfaces in motion; lists of pairs are kept while all vertices stay in their boxes."""

    def __init__(self, surfaces: Sequence[ContactSurface], policy: ContactPolicy):
        self._policy = policy
        self._lists = [_Candidates(surface, policy) for surface in surfaces]

    def find_rows(self, x: Floats) -> Rows:
        """Find the pairs within the policy's reach at positions x [mm], shape (k, 3)."""
        return Rows.concatenate([candidates.find_rows(x) for candidates in self._lists])

    def find_free_share(self, x: Floats, motion: Floats) -> float:
        """Find the share of a motion (k, 3) [mm] on which no pair comes nearer than `policy.kept` of its distance."""
        return min(candidates.find_free_share(x, motion) for candidates in self._lists)


class _Candidates:
    """Pairs of one surface that may come within reach while each vertex stays in its box (k, 3), low to high [mm]."""

    def __init__(self, surface: ContactSurface, policy: ContactPolicy):
        self._surface, self._policy = surface, policy
        self._reach = max(policy.reach, AHEAD * surface.offset)
        self._low = np.full((1, 3), np.inf)
        self._high = -self._low
        self._at: Floats | None = None
        self._least = 0.0

    def find_rows(self, x: Floats) -> Rows:
        """Find the rows of pairs within reach at positions x (k, 3) [mm]."""
        surface = self._surface
        self._search(x, x)
        which, weights, normals, distance = measure_near(x, self._pairs, self._of_vertices, self._reach)
        self._at, self._least = x, distance.min(initial=self._reach)
        ids, between_edges = self._pairs[which], which >= self._of_vertices
        areas = surface.weigh(ids, between_edges)
        offset = np.full(len(ids), surface.offset)
        if surface.has_close_pairs:
            at_rest = measure_near(surface.rest, ids, int(np.count_nonzero(~between_edges)), np.inf)[3]
            offset = np.minimum(offset, at_rest)
        shares = find_shares(x[ids], between_edges)
        rows = Rows(ids, between_edges, weights, normals, distance, offset, surface.stiffness * areas, *shares)
        return _merge(rows.select(np.flatnonzero((rows.share > 0.0) & (offset > LEAST))))

    def find_free_share(self, x: Floats, motion: Floats) -> float:
        self._search(x, x + motion)
        longest = float(np.sqrt(np.max(np.sum(motion**2, axis=1))))
        if x is self._at and 2.0 * longest <= (1.0 - self._policy.kept) * self._least:
            return 1.0
        return find_free_share(x, motion, self._pairs, self._of_vertices, self._policy.kept)

    def _search(self, x: Floats, ahead: Floats):
        """Find pairs anew where vertices leave their boxes on a straight way."""
        low, high = np.minimum(x, ahead), np.maximum(x, ahead)
        if np.all(low >= self._low) and np.all(high <= self._high):
            return
        self._low, self._high = low - self._policy.slack, high + self._policy.slack
        self._pairs, self._of_vertices = self._surface.find_candidates(self._low, self._high, self._reach)


def _merge(rows: Rows) -> Rows:
    """Make one row of pairs whose nearest points are of the same corners or edges, with their stiffnesses together.

    Edges that are all but parallel stay alone.
    """
    used = np.where(np.abs(rows.weights) > 1e-9, rows.ids + 1, 0)
    is_first = np.arange(4) < np.where(rows.between_edges, 2, 1)[:, None]
    most = int(rows.ids.max(initial=0)) + 2
    places = most ** np.array([0, 0, 1, 2])  # a side has three vertices at most
    sides = [np.sort(np.where(mask, used, 0), axis=1) @ places for mask in (is_first, ~is_first)]
    alone = np.where(rows.share < 1.0, np.arange(len(rows.ids)), -1)
    offsets = np.round(1e9 * rows.offset).astype(np.int64)
    keys = np.column_stack([np.minimum(*sides), np.maximum(*sides), offsets, alone])
    _, chosen, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = rows.select(chosen)
    together = np.bincount(which.ravel(), rows.stiffness, len(chosen)).astype(np.float64, copy=False)
    return replace(merged, stiffness=together)
