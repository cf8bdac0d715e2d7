"""Where a surface goes through itself: vertices in the flesh of another part, and edges that cross."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....lhm.base.geometry.triangles import crossed_edges, parting_shifts
from ....lhm.base.mesh import Floats, Ints, Surface
from .rows import Rows
from .surface import ContactSurface

TURNED = 0.3
"""A triangle whose normal has more than this cosine with a vertex' own is no place that the vertex went in at."""
PARALLEL = 0.1
"""Edges of a smaller sine between them have no direction to be parted in; the vertices at their ends do."""
TOUCHING = 1e-3
"""A gap [mm] too short to have a direction."""
MARGIN = 1.0
"""Vertices nearer than this share of a mean edge, beyond the thickness, are watched before they touch."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Constraints against what was found; crossing pairs of triangles without a common vertex; greatest depth [mm].

    The depth is the larger of how far a vertex lies behind the surface that it went through, and of the shortest shift
    that would part a crossing pair.
    """

    rows: Rows
    pairs: int
    depth: float

    @classmethod
    def together(cls, parts: Sequence[Detection]) -> Detection:
        """What was found on several surfaces."""
        rows = Rows.joined([part.rows for part in parts])
        return cls(rows, sum(part.pairs for part in parts), max(part.depth for part in parts))


def detect(contact: ContactSurface, x: Floats, earlier: Rows | None = None) -> Detection:
    """Look for contact at positions x [mm], shape (scene's vertices, 3).

    Edges of `earlier` constraints that pushed are watched still, for they stop to cross when they are parted.
    """
    surface = Surface(x[contact.ids], contact.triangles)
    points, normals, faces = surface.vertices, surface.vertex_normals, _unit(surface.face_normals)
    tree = contact.rest.moved(points)
    facing, on, distance = tree.closest_facing(points, -normals, faces, 0.0)
    inner, partner, at = _overlapping(contact, x)
    partner, at = _turned(contact, points, normals, faces, (inner, partner, at), (facing, on))
    away = np.linalg.norm(points[inner] - _points(points, contact.triangles[partner], at), axis=1)
    outer = _watched(contact, points, faces, facing, distance, inner)
    gap = points[outer] - _points(points, contact.triangles[facing[outer]], on[outer])
    pairs = tree.self_crossings()
    first, second = (tree.corners[pairs[:, k]] for k in range(2))
    edges = np.vstack([_crossed(contact, pairs, crossed_edges(first, second)), _kept(contact, earlier)])
    parts = [
        _vertex_rows(contact, inner, partner, at, faces[partner]),
        _vertex_rows(contact, outer, facing[outer], on[outer], _directions(gap, faces[facing[outer]])),
        _held(contact, x, np.concatenate([inner, outer]), earlier),
        _edge_rows(contact, points, normals, edges[~np.isin(edges, inner).any(axis=1)]),
    ]
    depths = np.concatenate([np.minimum(distance[inner], away), parting_shifts(first, second)])
    return Detection(Rows.joined(parts), len(pairs), float(depths.max(initial=0.0)))


def _directions(gaps: Floats, faces: Floats) -> Floats:
    """Unit vectors along gaps, shape (k, 3), and the normals of their triangles where a gap has no length."""
    length = np.linalg.norm(gaps, axis=1, keepdims=True)
    return np.where(length > TOUCHING, gaps / np.maximum(length, TOUCHING), faces)


def _points(vertices: Floats, triangles: Ints, weights: Floats) -> Floats:
    return np.einsum("rj,rjc->rc", weights, vertices[triangles])


def _overlapping(contact: ContactSurface, x: Floats) -> tuple[Ints, Ints, Floats]:
    """Vertices in the flesh of another part, with the triangle and the weights on it of the point they went in at.

    That point is the one nearest to where the flesh around the vertex lies at rest (McAdams et al. 2011, Section 5), so
    it is right however deep the vertex went, and thin flesh is not taken for a part that it overlaps.
    """
    points = x[contact.ids]
    pairs, weights = contact.flesh.moved(x).containing(points, contact.ids)
    rest = np.einsum("kj,kjc->kc", weights, contact.flesh.corners[pairs[:, 1]])
    triangle, at, away = contact.rest.closest(rest)
    vertex = pairs[:, 0]
    far = ~_is_near(contact, vertex, triangle)
    vertex, triangle, at, away = vertex[far], triangle[far], at[far], away[far]
    order = np.lexsort((away, vertex))
    vertex, first = np.unique(vertex[order], return_index=True)
    return vertex, triangle[order][first], at[order][first]


def _turned(
    contact: ContactSurface,
    points: Floats,
    normals: Floats,
    faces: Floats,
    found: tuple[Ints, Ints, Floats],
    facing: tuple[Ints, Floats],
) -> tuple[Ints, Floats]:
    """Triangle and weights of vertices in the flesh, taken from the triangle that faces them where theirs does not.

    At the rim of a part the surface nearest at rest may be one that a vertex slides along.
    """
    vertices, triangles, at = found
    other, on = facing[0][vertices], facing[1][vertices]
    aside = np.einsum("kc,kc->k", normals[vertices], faces[triangles]) > TURNED
    depth = np.einsum("kc,kc->k", points[contact.triangles[other, 0]] - points[vertices], faces[other])
    aside &= (other >= 0) & (depth >= 0) & ~_is_near(contact, vertices, other)
    return np.where(aside, other, triangles), np.where(aside[:, None], on, at)


def _is_near(contact: ContactSurface, vertices: Ints, triangles: Ints) -> np.ndarray:
    return contact.are_near(vertices[:, None], contact.triangles[triangles]).any(axis=1)


def _watched(
    contact: ContactSurface, points: Floats, faces: Floats, facing: Ints, distance: Floats, inner: Ints
) -> Ints:
    """Vertices outside and within reach in front of the surface that faces them."""
    edge = np.sqrt(contact.areas.mean())
    outer = distance <= contact.term.thickness + MARGIN * edge
    outer[inner] = False
    outer = np.flatnonzero(outer)
    corner = points[contact.triangles[facing[outer], 0]]
    ahead = np.einsum("kc,kc->k", points[outer] - corner, faces[facing[outer]]) >= 0
    outer = outer[ahead]
    return outer[~_is_near(contact, outer, facing[outer])]


def _kept(contact: ContactSurface, earlier: Rows | None) -> Ints:
    """The edges of earlier constraints on this surface that push, shape (r, 4)."""
    if earlier is None:
        return np.zeros((0, 4), dtype=np.int64)
    edges = earlier.ids[earlier.between_edges & (earlier.multipliers > 0.0)]
    local = np.minimum(np.searchsorted(contact.ids, edges), len(contact.ids) - 1)
    return local[(contact.ids[local] == edges).all(axis=1)]


def _held(contact: ContactSurface, x: Floats, found: Ints, earlier: Rows | None) -> Rows:
    """Earlier constraints of vertices that push, against the same triangles, but of vertices that were `found` anew.

    Without them a vertex that was parted from something that does not face it would go back in.
    """
    if earlier is None:
        return _vertex_rows(contact, found[:0], found[:0], np.zeros((0, 3)), np.zeros((0, 3)))
    lost = ~earlier.between_edges & (earlier.multipliers > 0.0) & np.isin(earlier.ids, contact.ids).all(axis=1)
    rows = earlier.chosen(lost & ~np.isin(earlier.ids[:, 0], contact.ids[found]))
    a, b, c = (x[rows.ids[:, k]] for k in (1, 2, 3))
    rows = replace(rows, normals=_unit(np.cross(b - a, c - a)))
    return rows.chosen(np.abs(rows.gaps(x)) < MARGIN * np.sqrt(contact.areas.mean()))


def _vertex_rows(contact: ContactSurface, vertices: Ints, triangles: Ints, at: Floats, normals: Floats) -> Rows:
    ids = contact.ids[np.column_stack([vertices, contact.triangles[triangles]])]
    weights = np.column_stack([np.ones(len(vertices)), -at])
    return _rows(contact, ids, weights, normals, contact.areas[vertices])


def _crossed(contact: ContactSurface, pairs: Ints, crossed: Ints) -> Ints:
    """Pairs of edges (a, b, c, d), shape (r, 4), that each go through a triangle at the other; a < b, c < d, a < c."""
    sides = []
    for side in range(2):
        triangles, corner = contact.triangles[pairs[crossed[:, 0], side]], crossed[:, 1 + side]
        ends = [np.take_along_axis(triangles, (corner[:, None] + k) % 3, axis=1) for k in range(2)]
        sides.append(np.sort(np.hstack(ends), axis=1))
    first, second = sides
    swap = first[:, :1] > second[:, :1]
    return np.where(swap, np.hstack([second, first]), np.hstack([first, second]))


def _edge_rows(contact: ContactSurface, points: Floats, normals: Floats, edges: Ints) -> Rows:
    """Constraints between edges (r, 4), where their nearest points lie inside both and they are not almost parallel."""
    edges = np.unique(edges, axis=0)
    edges = edges[~contact.are_near(edges[:, 0], edges[:, 2])]
    o, u = points[edges[:, 0]], points[edges[:, 1]] - points[edges[:, 0]]
    p, v = points[edges[:, 2]], points[edges[:, 3]] - points[edges[:, 2]]
    n = np.cross(u, v)
    outward = normals[edges[:, 2:]].sum(axis=1) - normals[edges[:, :2]].sum(axis=1)
    n *= np.where(np.einsum("kc,kc->k", n, outward) < 0, -1.0, 1.0)[:, None]
    sine = np.linalg.norm(n, axis=1) / np.maximum(np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1), 1e-30)
    s, t = _nearest(u, v, p - o)
    sound = (sine > PARALLEL) & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    weights = np.column_stack([1 - s, s, t - 1, -t])[sound]
    edges = edges[sound]
    return _rows(contact, contact.ids[edges], weights, _unit(n[sound]), contact.areas[edges].mean(axis=1))


def _nearest(u: Floats, v: Floats, between: Floats) -> tuple[Floats, Floats]:
    """Parameters (s, t) of the nearest points s u and between + t v of two lines."""
    uu, vv, uv = (np.einsum("kc,kc->k", a, b) for a, b in ((u, u), (v, v), (u, v)))
    ub, vb = np.einsum("kc,kc->k", u, between), np.einsum("kc,kc->k", v, between)
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    return (ub * vv - vb * uv) / det, (ub * uv - vb * uu) / det


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)


def _rows(contact: ContactSurface, ids: Ints, weights: Floats, normals: Floats, areas: Floats) -> Rows:
    thickness, none = np.full(len(ids), contact.term.thickness), np.zeros(len(ids))
    return Rows(ids, weights, normals, contact.term.stiffness * areas, thickness, none)
