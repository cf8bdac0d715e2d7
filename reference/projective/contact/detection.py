"""Where a surface goes through itself: vertices in the flesh of another part, and edges that cross."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, identity

from ....lhm.base.errors import SceneError
from ....lhm.base.geometry.bvh import TetTree, TriangleTree
from ....lhm.base.geometry.triangles import crossed_edges, parting_shifts
from ....lhm.base.mesh import FACES, Floats, Ints, Surface
from ...scene import Scene
from ...terms import Contact
from ..policy import POLICY, ContactPolicy
from .constraints import Constraints


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """The surface that a Contact term keeps from crossing itself, and the flesh behind it: constant during a solve.

    Triangles (m, 3) are over the surface's own k vertices, which are `ids` of the scene. areas (k,): rest areas [mm²]
    of the vertices; near: sorted numbers i k + j of vertices i and j that lie within two edges of one another.
    """

    term: Contact
    ids: Ints
    triangles: Ints
    areas: Floats
    near: Ints
    rest: TriangleTree
    flesh: TetTree
    policy: ContactPolicy = ContactPolicy()

    @classmethod
    def from_term(cls, scene: Scene, term: Contact, policy: ContactPolicy = POLICY.contact) -> ContactSurface:
        """The surface of a term and what lies behind it.

        Raises SceneError for a triangle that is no face of the tets' surface or is seen from inside, and for a vertex
        that lies in the flesh at rest, where nothing tells which way it came in.
        """
        _check_faces(scene, term)
        ids, local = np.unique(term.triangles, return_inverse=True)
        triangles = local.reshape(-1, 3)
        surface = Surface(scene.vertices[ids], triangles)
        rest = TriangleTree(surface.vertices, triangles)
        centres = scene.vertices[scene.tets].mean(axis=1)
        behind = scene.tets[rest.closest(centres)[2] < policy.reach]
        flesh = TetTree(scene.vertices, behind)
        held, weights = flesh.containing(surface.vertices, ids)
        inside = held[weights.min(axis=1) > policy.on_a_face, 0]
        if inside.size:
            raise SceneError(f"Contact: vertex {ids[inside[0]]} lies inside another tet at rest: parts overlap there")
        rows, columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, 3).ravel()
        share = csr_matrix((np.ones(len(rows), dtype=np.int32), (rows, columns)), shape=(len(ids),) * 2)
        ring = share + identity(len(ids), dtype=np.int32)
        pairs = (ring @ ring).tocoo()
        near = np.sort(pairs.row.astype(np.int64) * len(ids) + pairs.col)
        return cls(term, ids, triangles, surface.vertex_areas, near, rest, flesh, policy)

    def are_near(self, first: Ints, second: Ints) -> np.ndarray:
        """Whether pairs of the surface's vertices lie within two edges of one another."""
        keys = first * len(self.ids) + second
        return self.near[np.minimum(np.searchsorted(self.near, keys), len(self.near) - 1)] == keys


def _check_faces(scene: Scene, term: Contact):
    touched = np.zeros(len(scene.vertices), dtype=bool)
    touched[term.triangles] = True
    faces = scene.tets[:, FACES].reshape(-1, 3)
    faces = faces[touched[faces].all(axis=1)]
    _, which, count = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    border = {_rotate(face) for face in faces[count[which.ravel()] == 1].tolist()}
    for number, triangle in enumerate(term.triangles.tolist()):
        if _rotate(triangle) not in border:
            how = "is seen from inside" if _rotate(triangle[::-1]) in border else "is no face of the tets' surface"
            raise SceneError(f"Contact: triangle {number} {triangle} {how}")


def _rotate(triangle: list[int]) -> tuple[int, ...]:
    """The same triangle from its least vertex on."""
    first = triangle.index(min(triangle))
    return (*triangle[first:], *triangle[:first])


@dataclass(frozen=True, eq=False)
class Detection:
    """Constraints against what was found; crossing pairs of triangles without a common vertex; greatest depth [mm].

    The depth is the larger of how far a vertex lies behind the surface that it went through, and of the shortest shift
    that would part a crossing pair.
    """

    constraints: Constraints
    pairs: int
    depth: float

    @classmethod
    def merge(cls, parts: Sequence[Detection]) -> Detection:
        """Merge what several surfaces have."""
        rows = Constraints.concatenate([part.constraints for part in parts])
        return cls(rows, sum(part.pairs for part in parts), max(part.depth for part in parts))


def detect(contact: ContactSurface, x: Floats, earlier: Constraints | None = None) -> Detection:
    """Look for contact at positions x [mm], shape (scene's vertices, 3).

    Edges of `earlier` constraints that pushed are watched still, for they stop to cross when they are parted.
    """
    surface = Surface(x[contact.ids], contact.triangles)
    points, normals, faces = surface.vertices, surface.vertex_normals, _unit(surface.face_normals)
    tree = contact.rest.moved(points)
    facing, on, distance = tree.closest_facing(points, -normals, faces, 0.0)
    inner, partner, at = _inner_vertices(contact, x)
    partner, at = _face_partners(contact, points, normals, faces, (inner, partner, at), (facing, on))
    away = np.linalg.norm(points[inner] - _points(points, contact.triangles[partner], at), axis=1)
    outer = _outer_vertices(contact, points, faces, facing, distance, inner)
    gap = points[outer] - _points(points, contact.triangles[facing[outer]], on[outer])
    length, touching = np.linalg.norm(gap, axis=1, keepdims=True), contact.policy.touching
    along = np.where(length > touching, gap / np.maximum(length, touching), faces[facing[outer]])
    pairs = tree.self_crossings()
    first, second = (tree.corners[pairs[:, k]] for k in range(2))
    edges = np.vstack(
        [_find_crossing_edges(contact, pairs, crossed_edges(first, second)), _find_pushing_edges(contact, earlier)]
    )
    parts = [
        _vertex_rows(contact, inner, partner, at, faces[partner]),
        _vertex_rows(contact, outer, facing[outer], on[outer], along),
        _still_pushing(contact, x, np.concatenate([inner, outer]), earlier),
        _edge_rows(contact, points, normals, edges[~np.isin(edges, inner).any(axis=1)]),
    ]
    depths = np.concatenate([np.minimum(distance[inner], away), parting_shifts(first, second)])
    return Detection(Constraints.concatenate(parts), len(pairs), float(depths.max(initial=0.0)))


def _points(vertices: Floats, triangles: Ints, weights: Floats) -> Floats:
    return np.einsum("rj,rjc->rc", weights, vertices[triangles])


def _inner_vertices(contact: ContactSurface, x: Floats) -> tuple[Ints, Ints, Floats]:
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


def _face_partners(
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
    aside = np.einsum("kc,kc->k", normals[vertices], faces[triangles]) > contact.policy.turned
    depth = np.einsum("kc,kc->k", points[contact.triangles[other, 0]] - points[vertices], faces[other])
    aside &= (other >= 0) & (depth >= 0) & ~_is_near(contact, vertices, other)
    return np.where(aside, other, triangles), np.where(aside[:, None], on, at)


def _is_near(contact: ContactSurface, vertices: Ints, triangles: Ints) -> np.ndarray:
    return contact.are_near(vertices[:, None], contact.triangles[triangles]).any(axis=1)


def _outer_vertices(
    contact: ContactSurface, points: Floats, faces: Floats, facing: Ints, distance: Floats, inner: Ints
) -> Ints:
    """Vertices outside and within reach in front of the surface that faces them."""
    edge = np.sqrt(contact.areas.mean())
    outer = distance <= contact.term.thickness + contact.policy.margin * edge
    outer[inner] = False
    outer = np.flatnonzero(outer)
    corner = points[contact.triangles[facing[outer], 0]]
    ahead = np.einsum("kc,kc->k", points[outer] - corner, faces[facing[outer]]) >= 0
    outer = outer[ahead]
    return outer[~_is_near(contact, outer, facing[outer])]


def _find_pushing_edges(contact: ContactSurface, earlier: Constraints | None) -> Ints:
    """The edges of earlier constraints on this surface that push, shape (r, 4)."""
    if earlier is None:
        return np.zeros((0, 4), dtype=np.int64)
    edges = earlier.ids[earlier.between_edges & (earlier.multipliers > 0.0)]
    local = np.minimum(np.searchsorted(contact.ids, edges), len(contact.ids) - 1)
    return local[(contact.ids[local] == edges).all(axis=1)]


def _still_pushing(contact: ContactSurface, x: Floats, found: Ints, earlier: Constraints | None) -> Constraints:
    """Earlier constraints of vertices that push, against the same triangles, but of vertices that were `found` anew.

    Without them a vertex that was parted from something that does not face it would go back in.
    """
    if earlier is None:
        return _vertex_rows(contact, found[:0], found[:0], np.zeros((0, 3)), np.zeros((0, 3)))
    lost = ~earlier.between_edges & (earlier.multipliers > 0.0) & np.isin(earlier.ids, contact.ids).all(axis=1)
    rows = earlier.select(lost & ~np.isin(earlier.ids[:, 0], contact.ids[found]))
    a, b, c = (x[rows.ids[:, k]] for k in (1, 2, 3))
    rows = replace(rows, normals=_unit(np.cross(b - a, c - a)))
    return rows.select(np.abs(rows.gaps(x)) < contact.policy.margin * np.sqrt(contact.areas.mean()))


def _vertex_rows(contact: ContactSurface, vertices: Ints, triangles: Ints, at: Floats, normals: Floats) -> Constraints:
    ids = contact.ids[np.column_stack([vertices, contact.triangles[triangles]])]
    weights = np.column_stack([np.ones(len(vertices)), -at])
    return _rows(contact, ids, weights, normals, contact.areas[vertices])


def _find_crossing_edges(contact: ContactSurface, pairs: Ints, crossed: Ints) -> Ints:
    """Pairs of edges (a, b, c, d), shape (r, 4), that each go through a triangle at the other; a < b, c < d, a < c."""
    sides = []
    for side in range(2):
        triangles, corner = contact.triangles[pairs[crossed[:, 0], side]], crossed[:, 1 + side]
        ends = [np.take_along_axis(triangles, (corner[:, None] + k) % 3, axis=1) for k in range(2)]
        sides.append(np.sort(np.hstack(ends), axis=1))
    first, second = sides
    swap = first[:, :1] > second[:, :1]
    return np.where(swap, np.hstack([second, first]), np.hstack([first, second]))


def _edge_rows(contact: ContactSurface, points: Floats, normals: Floats, edges: Ints) -> Constraints:
    """Constraints between edges (r, 4), where their nearest points lie inside both and they are not almost parallel."""
    edges = np.unique(edges, axis=0)
    edges = edges[~contact.are_near(edges[:, 0], edges[:, 2])]
    o, u = points[edges[:, 0]], points[edges[:, 1]] - points[edges[:, 0]]
    p, v = points[edges[:, 2]], points[edges[:, 3]] - points[edges[:, 2]]
    n = np.cross(u, v)
    outward = normals[edges[:, 2:]].sum(axis=1) - normals[edges[:, :2]].sum(axis=1)
    n *= np.where(np.einsum("kc,kc->k", n, outward) < 0, -1.0, 1.0)[:, None]
    sine = np.linalg.norm(n, axis=1) / np.maximum(np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1), 1e-30)
    # The nearest points of the two lines, o + s u and p + t v.
    uu, vv, uv = (np.einsum("kc,kc->k", a, b) for a, b in ((u, u), (v, v), (u, v)))
    ub, vb = np.einsum("kc,kc->k", u, p - o), np.einsum("kc,kc->k", v, p - o)
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (ub * vv - vb * uv) / det, (ub * uv - vb * uu) / det
    sound = (sine > contact.policy.parallel) & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    weights = np.column_stack([1 - s, s, t - 1, -t])[sound]
    edges = edges[sound]
    return _rows(contact, contact.ids[edges], weights, _unit(n[sound]), contact.areas[edges].mean(axis=1))


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)


def _rows(contact: ContactSurface, ids: Ints, weights: Floats, normals: Floats, areas: Floats) -> Constraints:
    thickness, none = np.full(len(ids), contact.term.thickness), np.zeros(len(ids))
    return Constraints(ids, weights, normals, contact.term.stiffness * areas, thickness, none)
