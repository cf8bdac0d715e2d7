"""The surface a Contact term keeps from crossing itself, and the flesh behind it: what does not change in a solve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, identity

from ....lhm.base.errors import SceneError
from ....lhm.base.geometry.bvh import TetTree, TriangleTree
from ....lhm.base.mesh import Floats, Ints, Surface
from ...scene import Scene
from ...terms import Contact

REACH = 15.0
"""How far behind the surface [mm] flesh is looked through for vertices that went in: the deepest overlap seen."""
ON_A_FACE = 1e-6
"""A vertex with a lesser barycentric weight in a tet touches it only."""
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""A tet's faces, each seen counter-clockwise from outside."""


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """Triangles (m, 3) over the surface's own k vertices, which are `ids` of the scene, and the tets behind them.

    areas (k,): rest areas [mm²] of the vertices; near: sorted numbers i k + j of vertices i
    and j that lie within two edges of one another.
    """

    term: Contact
    ids: Ints
    triangles: Ints
    areas: Floats
    near: Ints
    rest: TriangleTree
    flesh: TetTree

    @classmethod
    def of(cls, scene: Scene, term: Contact) -> ContactSurface:
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
        behind = scene.tets[rest.closest(centres)[2] < REACH]
        flesh = TetTree(scene.vertices, behind)
        held, weights = flesh.containing(surface.vertices, ids)
        inside = held[weights.min(axis=1) > ON_A_FACE, 0]
        if inside.size:
            raise SceneError(f"Contact: vertex {ids[inside[0]]} lies inside another tet at rest: parts overlap there")
        return cls(term, ids, triangles, surface.vertex_areas, _near(triangles), rest, flesh)

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
    border = {_turned(face) for face in faces[count[which.ravel()] == 1].tolist()}
    for number, triangle in enumerate(term.triangles.tolist()):
        if _turned(triangle) not in border:
            how = "is seen from inside" if _turned(triangle[::-1]) in border else "is no face of the tets' surface"
            raise SceneError(f"Contact: triangle {number} {triangle} {how}")


def _turned(triangle: list[int]) -> tuple[int, ...]:
    """The same triangle from its least vertex on."""
    first = triangle.index(min(triangle))
    return (*triangle[first:], *triangle[:first])


def _near(triangles: Ints) -> Ints:
    n = triangles.max() + 1
    rows, columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, 3).ravel()
    ring = csr_matrix((np.ones(len(rows), dtype=np.int32), (rows, columns)), shape=(n, n)) + identity(n, dtype=np.int32)
    pairs = (ring @ ring).tocoo()
    return np.sort(pairs.row.astype(np.int64) * n + pairs.col)
