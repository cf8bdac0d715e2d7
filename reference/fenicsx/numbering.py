"""The scene's mesh in dolfinx, and the maps between both numberings of vertices and tets, and of the nodes on edges."""

from __future__ import annotations

import numpy as np

from ...lhm.errors import SceneError
from ...lhm.mesh import Floats, Ints
from ..scene import Scene
from . import dolfinx_version as seam

CORNERS = np.repeat(np.arange(4)[:, None], 2, axis=1)
EDGES = np.array([[2, 3], [1, 3], [1, 2], [0, 3], [0, 2], [0, 1]])
"""Ends of the local nodes of quadratic tets after their corners; on faces the nodes lie opposite to the corners."""
FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
# Integrals of the shape functions over a tet and a triangle, per volume and per area.
CELL_SHARES = {1: np.full(4, 1 / 4), 2: np.repeat([-1 / 20, 1 / 5], [4, 6])}
FACE_SHARES = {1: np.full(3, 1 / 3), 2: np.repeat([0.0, 1 / 3], 3)}


class Numbering:
    """A space of degree 1 or 2 on the scene's tets.

    `ends` (n, 2) are the scene's vertices between which a node lies in the middle, twice the same at a corner;
    `corners` (k,) are the nodes at vertices, `vertex` (k,) theirs, and `dof` (scene vertices,) the inverse, -1 for a
    vertex in no tet; `tet` (m,) is the scene's tet per cell, `cell` its inverse; `X` [mm], shape (n, 3), are rest
    positions by node.
    """

    def __init__(self, scene: Scene, degree: int = 1):
        domain = seam.tet_mesh(scene.vertices, scene.tets)
        self.degree = degree
        self.space = seam.vector_space(domain, degree)
        local = CORNERS if degree == 1 else np.concatenate([CORNERS, EDGES])
        self.cell_vertices = seam.cell_vertices(domain)
        self.cell_dofs = seam.cell_dofs(self.space, len(local))
        self.ends = np.full((seam.dof_count(self.space), 2), -1, dtype=np.int64)
        self.ends[self.cell_dofs] = np.sort(self.cell_vertices[:, local], axis=2)
        self.corners = np.flatnonzero(self.ends[:, 0] == self.ends[:, 1])
        self.vertex = self.ends[self.corners, 0]
        self.dof = np.full(len(scene.vertices), -1, dtype=np.int64)
        self.dof[self.vertex] = self.corners
        self.tet = seam.cell_tets(domain)
        self.cell = np.empty_like(self.tet)
        self.cell[self.tet] = np.arange(len(self.tet))
        self.cell_volumes = scene.volumes[self.tet]
        self.X: Floats = self.to_dofs(scene.vertices)
        keys = self.ends @ [len(scene.vertices), 1]
        self._by_key = np.argsort(keys)
        self._keys = keys[self._by_key]

    def dofs_of(self, name: str, vertices: Ints) -> Ints:
        """Dofs of a term's vertices, in their shape; SceneError for a vertex that is in no tet."""
        dofs = self.dof[vertices]
        if (dofs < 0).any():
            raise SceneError(f"{name}: vertex {vertices[dofs < 0][0]} is in no tet; solver 'fenicsx' cannot move it")
        return dofs

    def face_dofs(self, name: str, triangles: Ints) -> Ints:
        """Dofs of a term's triangles (k, 3), their corners first: (k, 3) or, of degree 2, (k, 6).

        Raises SceneError for a vertex in no tet, and of degree 2 for a triangle whose sides are not edges of tets.
        """
        corners = self.dofs_of(name, triangles)
        if self.degree == 1:
            return corners
        sides = np.sort(triangles[:, [[1, 2], [0, 2], [0, 1]]], axis=2)
        keys = sides @ [len(self.dof), 1]
        slots = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        missing = (self._keys[slots] != keys).any(axis=1)
        if missing.any():
            which = np.flatnonzero(missing)[0]
            raise SceneError(f"{name}: triangle {which} is no face of a tet; quadratic elements need its edges' nodes")
        return np.concatenate([corners, self._by_key[slots]], axis=1)

    def nodes_between(self, ends: Ints) -> Ints:
        """The nodes, shape (k,), of ends (k, 2) that nodes are known to have; an end twice is a vertex."""
        return self._by_key[np.searchsorted(self._keys, np.sort(ends, axis=1) @ [len(self.dof), 1])]

    def to_dofs(self, values: Floats) -> Floats:
        """Values per scene vertex, shape (scene vertices, 3), by node: their mean on edges."""
        return values[self.ends].mean(axis=1)

    def held(self, held: np.ndarray) -> np.ndarray:
        """Which components of nodes (n, 3) are held where vertices (scene vertices, 3) are.

        A node on an edge is, if a face of the boundary has the edge, and all its three vertices are held: an edge
        through the inside is free though both its ends lie on held faces.
        """
        result = held[self.ends].all(axis=1)
        if self.degree == 1:
            return result
        faces = self.cell_vertices[:, FACES].reshape(-1, 3)
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        boundary = faces[first[count == 1]]
        nodes = self.face_dofs("boundary", boundary)[:, 3:]
        on_held = np.zeros_like(result)
        for c in range(3):
            on_held[nodes[held[boundary, c].all(axis=1)].ravel(), c] = True
        on_held[self.corners] = True
        return result & on_held

    def to_scene(self, values: Floats, elsewhere: Floats) -> Floats:
        """Values by node (n, 3) per scene vertex, and `elsewhere`'s (scene vertices, 3) for vertices in no tet."""
        result = np.array(elsewhere)
        result[self.vertex] = values[self.corners]
        return result
