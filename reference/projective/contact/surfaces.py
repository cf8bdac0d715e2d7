"""Surfaces that must not cross themselves, the rows of what is near on them, and how far a step may go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ....lhm.base.geometry.bvh import BoxTree
from ....lhm.base.geometry.topology import unique_edges
from ....lhm.base.mesh import Floats, Ints, Surface
from ...scene import Scene
from ...terms import Contact
from ..policy import ContactPolicy
from .pairs import find_free_share, measure_near


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """The surface of a Contact term: triangles (m, 3) and edges (e, 2) over the vertices that all terms have together.

    rest (k, 3) [mm] are those vertices at rest, areas (k,) [mm²] this surface's share about each; offset [mm] is the
    distance below which it pushes, unless a pair is nearer at rest; stiffness [kPa/mm].
    """

    triangles: Ints
    edges: Ints
    rest: Floats
    areas: Floats
    offset: float
    stiffness: float
    trees: tuple[BoxTree, BoxTree]

    @classmethod
    def from_scene(cls, scene: Scene, policy: ContactPolicy) -> tuple[Ints, tuple[ContactSurface, ...]]:
        """Make the surfaces of a scene, and the numbers in it of their vertices, shape (k,)."""
        contacts = scene.of(Contact)
        ids = np.unique(np.concatenate([term.triangles.ravel() for term in contacts]))
        rest = scene.vertices[ids]
        surfaces = []
        for term in contacts:
            triangles = np.searchsorted(ids, term.triangles)
            areas = Surface(rest, triangles).vertex_areas
            offset = term.thickness + policy.offset
            edges = unique_edges(triangles)
            of_triangles, of_edges = (BoxTree(enclose(each, rest, rest), each) for each in (triangles, edges))
            surfaces.append(cls(triangles, edges, rest, areas, offset, term.stiffness, (of_triangles, of_edges)))
        return ids, tuple(surfaces)

    @cached_property
    def vertices(self) -> Ints:
        """Its own among the contact vertices, shape (v,)."""
        return np.unique(self.triangles)

    @cached_property
    def has_close_pairs(self) -> bool:
        """Whether some pairs are nearer at rest than the offset."""
        pairs, of_vertices = self.find_candidates(self.rest, self.rest, self.offset)
        return bool(len(measure_near(self.rest, pairs, of_vertices, self.offset)[0]))

    def find_candidates(self, low: Floats, high: Floats, reach: float) -> tuple[Ints, int]:
        """Find the pairs (r, 4) that may come within `reach` [mm] while each vertex stays in its box.

        low, high (k, 3): the boxes' ends [mm]. Also returns how many pairs, the first, are of vertices and triangles.
        """
        low, high = low - 0.5 * reach, high + 0.5 * reach
        of_triangles, of_edges = (tree.moved(enclose(tree.ids, low, high)) for tree in self.trees)
        vertices = self.vertices[:, None]
        ends = of_triangles.overlaps(enclose(vertices, low, high), vertices)
        sides = of_edges.self_overlaps()
        of_vertices = np.hstack([vertices[ends[:, 0]], self.triangles[ends[:, 1]]])
        between_edges = np.hstack([self.edges[sides[:, 0]], self.edges[sides[:, 1]]])
        return np.vstack([of_vertices, between_edges]), len(of_vertices)


def enclose(elements: Ints, low: Floats, high: Floats) -> Floats:
    """Return boxes (m, 6) about elements (m, any) of vertices in boxes low to high (k, 3)."""
    return np.hstack([low[elements].min(axis=1), high[elements].max(axis=1)])


@dataclass(frozen=True, eq=False)
class Rows:
    """Pairs near one another, r of them, and the energy ½ Σ stiffness max(depth, 0)² [µJ] of what is too near.

    ids (r, 4) of the contact vertices and between_edges (r,): the pairs, as of `terms.Gaps`; weights (r, 4) and
    normals (r, 3) of their gaps, see `terms.gaps.measure_pair`; distance and offset (r,) [mm]; stiffness (r,) [mN/mm].
    """

    ids: Ints
    between_edges: np.ndarray
    weights: Floats
    normals: Floats
    distance: Floats
    offset: Floats
    stiffness: Floats

    @cached_property
    def depth(self) -> Floats:
        """The offset less the distance [mm], shape (r,)."""
        return self.offset - self.distance

    @classmethod
    def concatenate(cls, parts: Sequence[Rows]) -> Rows:
        """Concatenate the rows of several surfaces."""
        return cls(*(np.concatenate([getattr(rows, field.name) for rows in parts]) for field in fields(cls)))

    def select(self, which: Ints) -> Rows:
        """Select some rows."""
        return Rows(*(getattr(self, field.name)[which] for field in fields(self)))

    @property
    def energy(self) -> float:
        """The energy [µJ]."""
        return float(0.5 * np.sum(self.stiffness * np.maximum(self.depth, 0.0) ** 2))

    @property
    def forces(self) -> Floats:
        """The forces [mN], shape (r,), that push each pair apart."""
        return self.stiffness * np.maximum(self.depth, 0.0)

    def spread(self, forces: Floats, count: int) -> Floats:
        """Spread forces (r,) along the gaps over the contact vertices, shape (count, 3)."""
        pushes = (forces[:, None] * self.weights)[:, :, None] * self.normals[:, None, :]
        ids = self.ids.ravel()
        return np.stack([np.bincount(ids, pushes[..., c].ravel(), count) for c in range(3)], axis=1)

    def widen(self, motion: Floats) -> Floats:
        """Tell by how much a motion (k, 3) [mm] widens each gap, shape (r,)."""
        return np.einsum("rj,rjc,rc->r", self.weights, motion[self.ids], self.normals)


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
        self._low = np.full((1, 3), np.inf)
        self._high = -self._low
        self._at: Floats | None = None
        self._least = 0.0

    def find_rows(self, x: Floats) -> Rows:
        """See `Nearby`."""
        surface = self._surface
        self._search(x, x)
        which, weights, normals, distance = measure_near(x, self._pairs, self._of_vertices, self._policy.reach)
        self._at, self._least = x, distance.min(initial=self._policy.reach)
        ids, between_edges = self._pairs[which], which >= self._of_vertices
        areas = np.where(between_edges, surface.areas[ids].mean(axis=1), surface.areas[ids[:, 0]])
        offset = np.full(len(ids), surface.offset)
        if surface.has_close_pairs:
            at_rest = measure_near(surface.rest, ids, int(np.count_nonzero(~between_edges)), np.inf)[3]
            offset = np.minimum(offset, at_rest)
        return _merge(Rows(ids, between_edges, weights, normals, distance, offset, surface.stiffness * areas))

    def find_free_share(self, x: Floats, motion: Floats) -> float:
        """See `Nearby`."""
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
        self._pairs, self._of_vertices = self._surface.find_candidates(self._low, self._high, self._policy.reach)


def _merge(rows: Rows) -> Rows:
    """Make one row of pairs whose nearest points are of the same corners or edges, with their stiffnesses together."""
    used = np.where(np.abs(rows.weights) > 1e-9, rows.ids + 1, 0)
    is_first = np.arange(4) < np.where(rows.between_edges, 2, 1)[:, None]
    most = int(rows.ids.max(initial=0)) + 2
    places = most ** np.array([0, 0, 1, 2])  # a side has three vertices at most
    sides = [np.sort(np.where(mask, used, 0), axis=1) @ places for mask in (is_first, ~is_first)]
    keys = np.column_stack([np.minimum(*sides), np.maximum(*sides), np.round(1e9 * rows.offset).astype(np.int64)])
    _, chosen, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = rows.select(chosen)
    together = np.bincount(which.ravel(), rows.stiffness, len(chosen)).astype(np.float64, copy=False)
    return replace(merged, stiffness=together)
