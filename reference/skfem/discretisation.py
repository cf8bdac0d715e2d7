"""Linear or quadratic tets over a scene's mesh, in scikit-fem's numbering of degrees of freedom."""

from __future__ import annotations

import numpy as np
from skfem import Basis, ElementTetP1, ElementTetP2, ElementTriP1, ElementTriP2, ElementVector, MeshTet

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from .elements import Elements
from .membrane import rest_gradients
from .quadrature import tet_rule, triangle_rule

DEGREES = {"P1": 1, "P2": 2}
TETS = {1: ElementTetP1(), 2: ElementTetP2()}
TRIANGLES = {1: ElementTriP1(), 2: ElementTriP2()}


class Discretisation:
    """Nodes at a scene's n vertices, and of quadratic tets ("P2") in the middles of their edges behind those.

    `dofs` (nodes, 3) is where scikit-fem numbers the components of each node, `vertex_dofs` (n, 3) the vertices' part,
    and `ends` (nodes, 2) the vertices that a node lies between, twice the same at a vertex. scikit-fem does not count
    vertices behind the last one of a tet: their dofs follow after its own. `tets` are the elements, `element` their
    name.
    """

    def __init__(self, scene: Scene, element: str = "P1"):
        self.element, self._degree = element, DEGREES[element]
        self._scene = scene
        points, corners = (np.ascontiguousarray(array.T) for array in (scene.vertices, scene.tets))
        self.basis = Basis(
            MeshTet(points, corners), ElementVector(TETS[self._degree]), quadrature=tet_rule(self._degree)
        )
        n, vertices = len(scene.vertices), self.basis.nodal_dofs.T
        on_edges = self.basis.edge_dofs.T if self._degree == 2 else np.empty((0, 3), dtype=np.int64)
        edges = np.sort(self.basis.mesh.edges.T, axis=1)[: len(on_edges)]
        self.ends: Ints = np.concatenate([np.repeat(np.arange(n)[:, None], 2, axis=1), edges])
        self.size = 3 * len(self.ends)
        behind = np.arange(self.basis.N, self.size).reshape(-1, 3)
        self.dofs: Ints = np.concatenate([vertices, behind, on_edges])
        self.vertex_dofs: Ints = self.dofs[:n]
        keys = edges @ [n, 1]
        self._order = np.argsort(keys)
        self._keys = keys[self._order]
        self.tets = self._tets()

    def flat(self, values: Floats) -> Floats:
        """Values per vertex, shape (n, 3), by degree of freedom; on edges the mean of their ends."""
        values = np.asarray(values)
        result = np.empty(self.size)
        result[self.dofs] = (values[self.ends[:, 0]] + values[self.ends[:, 1]]) / 2
        return result

    def held(self, vertices: np.ndarray) -> np.ndarray:
        """Which degrees of freedom (size,) are held where components of vertices are, a mask (n, 3).

        A node on an edge is held where all of a face of the boundary is: an edge through the inside that joins two held
        faces stays free.
        """
        nodes = np.zeros(self.dofs.shape, dtype=bool)
        nodes[: len(vertices)] = vertices
        if self._degree == 2:
            mesh = self.basis.mesh
            faces = mesh.facets[:, mesh.boundary_facets()].T
            on_sides = self.nodes_of("boundary", faces)[:, 3:]
            for c in range(3):
                nodes[on_sides[vertices[faces, c].all(axis=1)], c] = True
        result = np.empty(self.size, dtype=bool)
        result[self.dofs] = nodes
        return result

    def nodes_of(self, name: str, triangles: Ints) -> Ints:
        """The nodes of a term's triangles (k, 3) as scikit-fem orders them, shape (k, 3) or, of quadratic ones, (k, 6).

        Raises SceneError for a side of a quadratic triangle that is no edge of a tet.
        """
        if self._degree == 1:
            return triangles
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]], axis=2) @ [len(self.vertex_dofs), 1]
        found = np.minimum(np.searchsorted(self._keys, sides), len(self._keys) - 1)
        missing = np.flatnonzero((self._keys[found] != sides).any(axis=1))
        if missing.size:
            raise SceneError(f"{name}: triangle {missing[0]} is no face of a tet; quadratic elements need its edges")
        return np.concatenate([triangles, len(self.vertex_dofs) + self._order[found]], axis=1)

    def triangles(self, name: str, triangles: Ints, rest: Floats | None = None) -> Elements:
        """Triangles (k, 3) of vertices as elements; gradients are by the plane of `rest` [mm], default the scene's.

        Raises SceneError as `nodes_of` does.
        """
        X = self._scene.vertices
        _, areas = rest_gradients(X, triangles)
        linear, _ = rest_gradients(X if rest is None else rest, triangles)
        points, weights = triangle_rule(self._degree)
        nodes = self.nodes_of(name, triangles)
        both = [TRIANGLES[self._degree].lbasis(points, a) for a in range(nodes.shape[1])]
        shapes = np.stack([shape + np.zeros_like(weights) for shape, _ in both], axis=1)
        by_reference = np.stack([np.broadcast_to(d.T, (len(weights), 2)) for _, d in both], axis=1)
        # The last two barycentric coordinates are scikit-fem's on the reference triangle.
        gradients = by_reference @ linear[:, None, 1:]
        return Elements(
            self.flat(self._scene.vertices), self.dofs[nodes], np.outer(areas, 2 * weights), shapes, gradients
        )

    def _tets(self) -> Elements:
        m, k = len(self._scene.tets), self.basis.Nbfun // 3
        first = [self.basis.basis[3 * a][0] for a in range(k)]  # of the three components the first
        gradients = np.stack([field.grad[0].transpose(1, 2, 0) for field in first], axis=2)
        points, _ = tet_rule(self._degree)
        shapes = [TETS[self._degree].lbasis(points, a)[0] + np.zeros(points.shape[1]) for a in range(k)]
        dofs = self.basis.element_dofs.T.reshape(m, k, 3).astype(np.int64)
        return Elements(self.flat(self._scene.vertices), dofs, self.basis.dx, np.stack(shapes, axis=1), gradients)
