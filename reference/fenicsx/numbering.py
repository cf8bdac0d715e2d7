"""The scene's mesh in dolfinx, and the maps between both numberings of vertices and tets."""

from __future__ import annotations

import numpy as np

from ...lhm.errors import SceneError
from ...lhm.mesh import Floats, Ints
from ..scene import Scene
from . import dolfinx_version as seam


class Numbering:
    """A P1 space on the scene's tets.

    `vertex` (n,) is the scene's vertex per block dof, `dof` (scene vertices,) its inverse, -1 for a vertex in no tet;
    `tet` (m,) is the scene's tet per cell, `cell` its inverse; `X` [mm], shape (n, 3), are rest positions by dof.
    """

    def __init__(self, scene: Scene):
        domain = seam.tet_mesh(scene.vertices, scene.tets)
        self.space = seam.vector_space(domain)
        self.vertex = seam.dof_vertices(self.space)
        self.dof = np.full(len(scene.vertices), -1, dtype=np.int64)
        self.dof[self.vertex] = np.arange(len(self.vertex))
        self.tet = seam.cell_tets(domain)
        self.cell = np.empty_like(self.tet)
        self.cell[self.tet] = np.arange(len(self.tet))
        self.cell_dofs = seam.cell_dofs(self.space, 4)
        self.cell_volumes = scene.volumes[self.tet]
        self.X: Floats = scene.vertices[self.vertex]

    def dofs_of(self, name: str, vertices: Ints) -> Ints:
        """Dofs of a term's vertices, in their shape; SceneError for a vertex that is in no tet."""
        dofs = self.dof[vertices]
        if (dofs < 0).any():
            raise SceneError(f"{name}: vertex {vertices[dofs < 0][0]} is in no tet; solver 'fenicsx' cannot move it")
        return dofs

    def to_dofs(self, values: Floats) -> Floats:
        """Values per scene vertex, shape (scene vertices, 3), by dof."""
        return values[self.vertex]

    def to_scene(self, values: Floats, elsewhere: Floats) -> Floats:
        """Values by dof (n, 3) per scene vertex, and `elsewhere`'s (scene vertices, 3) for vertices in no tet."""
        result = np.array(elsewhere)
        result[self.vertex] = values
        return result
