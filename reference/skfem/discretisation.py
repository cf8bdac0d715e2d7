"""Linear or quadratic tets over a scene's mesh: points, elements, and scikit-fem's numbering of degrees of freedom.

All weights of the rules are positive: with a negative one, semi-definite tangents at the points would not add up to a
semi-definite one of the element.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from skfem import Basis, ElementTetP1, ElementTetP2, ElementTriP1, ElementTriP2, ElementVector, MeshTet
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet, RefTri

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene

DEGREES = {"P1": 1, "P2": 2}
TETS = {1: ElementTetP1(), 2: ElementTetP2()}
TRIANGLES = {1: ElementTriP1(), 2: ElementTriP2()}

# Keast (1986), the rule of 14 points and degree 4: six edges' middles, then twice four points (1 - 3a, a, a, a) in
# barycentric coordinates. scikit-fem's own rule of that degree has a negative weight.
EDGE_WEIGHT = 2 / 105
ORBITS = ((0.10052676522520447, 0.08858982474298065), (0.31437287349319220, 0.13283874668559070))


def tet_rule(degree: int) -> tuple[Floats, Floats]:
    """Points (3, q) and weights (q,) for tets of degree 1 or 2: exact for polynomials of degree 1 or 4."""
    if degree == 1:
        return get_quadrature(RefTet, 1)
    barycentric = [0.5 * (np.eye(4)[i] + np.eye(4)[j]) for i in range(4) for j in range(i)]
    weights = [EDGE_WEIGHT] * 6
    for a, weight in ORBITS:
        barycentric += list(a + (1 - 4 * a) * np.eye(4))
        weights += [weight] * 4
    return np.array(barycentric).T[1:], np.array(weights) / 6


def triangle_rule(degree: int) -> tuple[Floats, Floats]:
    """Points (2, q) and weights (q,) for triangles of degree 1 or 2: exact for polynomials of degree 1 or 4."""
    if degree == 1:
        return np.full((2, 1), 1 / 3), np.array([1 / 2])
    return get_quadrature(RefTri, 4)


@dataclass(frozen=True, eq=False)
class Elements:
    """m elements of k nodes and q points in d dimensions.

    rest [mm], shape (size,), are all nodes' places by degree of freedom; dofs (m, k, 3); weights (m, q) [mm^d], what
    each point stands for; shape functions (q, k) and their gradients (m, q, k, d) [1/mm]. Points are counted element by
    element.
    """

    rest: Floats
    dofs: Ints
    weights: Floats
    shapes: Floats
    gradients: Floats

    def points(self, elements: Ints) -> Ints:
        """The points of some elements (e,), shape (e q,)."""
        q = self.weights.shape[1]
        return (q * elements[:, None] + np.arange(q)).ravel()

    def at_points(self, values) -> Floats:
        """One number, or one per element, as one per point, shape (m q,)."""
        m, q = self.weights.shape
        return np.repeat(np.broadcast_to(values, (m,)).astype(np.float64), q)

    def deformation_gradients(self, x: Floats) -> Floats:
        """F at the points, shape (m q, 3, d); from displacements, whose rounding is less than that of places."""
        return self._at_rest + self._gradient(x - self.rest)

    @cached_property
    def _at_rest(self) -> Floats:
        return self._gradient(self.rest)

    def _gradient(self, values: Floats) -> Floats:
        gradient = values[self.dofs].transpose(0, 2, 1)[:, None] @ self.gradients
        return gradient.reshape(-1, 3, gradient.shape[-1])

    def integral(self, psi: Floats) -> float:
        """Integrate a density at the points, shape (m q,)."""
        return float(self.weights.ravel() @ psi)

    def forces(self, stress: Floats) -> Floats:
        """The integral of P : grad v by degree of freedom, shape (size,), from P at the points (m q, 3, d)."""
        k, d = self.gradients.shape[2:]
        weighted = (self.weights.reshape(-1, 1, 1) * stress).reshape(len(self.dofs), -1, 3, d)
        forces = self._sum_by_node() @ weighted.transpose(0, 1, 3, 2).reshape(len(self.dofs), -1, 3)
        return self._gather(forces.reshape(-1, 3 * k))

    def stiffness(self, tangent: Floats) -> csr_matrix:
        """The integral of grad v : C : grad u, shape (size, size), from C at the points (m q, 3, d, 3, d)."""
        m = len(self.dofs)
        q, k, d = self.gradients.shape[1:]
        weighted = (self.weights.reshape(-1, 1, 1) * tangent.reshape(m * q, -1, d)).reshape(m, q, -1, d)
        # Axes: element, point, component and direction of v, component and node of u.
        of_u = (weighted @ self.gradients.transpose(0, 1, 3, 2)).reshape(m, q, 3, d, 3 * k)
        blocks = self._sum_by_node() @ of_u.transpose(0, 1, 3, 2, 4).reshape(m, q * d, -1)
        blocks = blocks.reshape(m, 3 * k, 3, k).transpose(0, 1, 3, 2)
        rows = np.broadcast_to(self.dofs.reshape(m, 3 * k, 1, 1), blocks.shape)
        columns = np.broadcast_to(self.dofs[:, None], blocks.shape)
        shape = (len(self.rest), len(self.rest))
        return coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()

    def loads(self, force: Floats) -> Floats:
        """Nodal forces [mN], shape (size,), of one force per weight and element, shape (m, 3)."""
        shares = self.weights @ self.shapes
        return self._gather(shares[:, :, None] * force[:, None, :])

    def _gather(self, parts: Floats) -> Floats:
        """The sum over the elements by degree of freedom, shape (size,), of parts (m, k, 3)."""
        return np.bincount(self.dofs.ravel(), parts.ravel(), minlength=len(self.rest)).astype(np.float64, copy=False)

    def _sum_by_node(self) -> Floats:
        """Gradients, shape (m, k, q d)."""
        m, q, k, d = self.gradients.shape
        return self.gradients.transpose(0, 2, 1, 3).reshape(m, k, q * d)


def rest_gradients(X: Floats, triangles: Ints) -> tuple[Floats, Floats]:
    """Gradients G (m, 3 corners, 2) [1/mm] of the shape functions in each triangle's plane, and areas [mm²], (m,).

    F = sum over corners of x_corner ⊗ G_corner.
    """
    origin, first, second = (X[triangles[:, k]] for k in range(3))
    edges = np.stack([first - origin, second - origin], axis=2)
    # A QR factorisation gives the two edges in an orthonormal frame of the plane.
    in_plane = np.linalg.qr(edges)[1]
    inverse = np.linalg.inv(in_plane)
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1), abs(np.linalg.det(in_plane)) / 2


class Discretisation:
    """Nodes at a scene's n vertices, and of quadratic tets ("P2") in the middles of their edges behind those.

    `dofs` (nodes, 3) is where scikit-fem numbers the components of each node, `vertex_dofs` (n, 3) the vertices' part,
    and `ends` (nodes, 2) the vertices that a node lies between, twice the same at a vertex. scikit-fem does not count
    vertices behind the last one of a tet: their dofs follow after its own. `tets` are the elements, `element` their
    name.
    """

    def __init__(self, scene: Scene, element: str = "P1"):
        self.element, self.degree = element, DEGREES[element]
        self._scene = scene
        points, corners = (np.ascontiguousarray(array.T) for array in (scene.vertices, scene.tets))
        self.basis = Basis(MeshTet(points, corners), ElementVector(TETS[self.degree]), quadrature=tet_rule(self.degree))
        n, vertices = len(scene.vertices), self.basis.nodal_dofs.T
        on_edges = self.basis.edge_dofs.T if self.degree == 2 else np.empty((0, 3), dtype=np.int64)
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

    def by_dof(self, values: Floats) -> Floats:
        """Values per vertex, shape (n, 3), by degree of freedom; on edges the mean of their ends."""
        values = np.asarray(values)
        result = np.empty(self.size)
        result[self.dofs] = (values[self.ends[:, 0]] + values[self.ends[:, 1]]) / 2
        return result

    def held_dofs(self, vertices: np.ndarray) -> np.ndarray:
        """Mask the degrees of freedom (size,) that are held where components of vertices are, a mask (n, 3).

        A node on an edge is held where all of a face of the boundary is: an edge through the inside that joins two held
        faces stays free.
        """
        nodes = np.zeros(self.dofs.shape, dtype=bool)
        nodes[: len(vertices)] = vertices
        if self.degree == 2:
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
        if self.degree == 1:
            return triangles
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]], axis=2) @ [len(self.vertex_dofs), 1]
        edge = np.minimum(np.searchsorted(self._keys, sides), len(self._keys) - 1)
        missing = np.flatnonzero((self._keys[edge] != sides).any(axis=1))
        if missing.size:
            raise SceneError(f"{name}: triangle {missing[0]} is no face of a tet; quadratic elements need its edges")
        return np.concatenate([triangles, len(self.vertex_dofs) + self._order[edge]], axis=1)

    def triangles(self, name: str, triangles: Ints, rest: Floats | None = None) -> Elements:
        """Triangles (k, 3) of vertices as elements; gradients are by the plane of `rest` [mm], default the scene's.

        Raises SceneError as `nodes_of` does.
        """
        X = self._scene.vertices
        _, areas = rest_gradients(X, triangles)
        linear, _ = rest_gradients(X if rest is None else rest, triangles)
        points, weights = triangle_rule(self.degree)
        nodes = self.nodes_of(name, triangles)
        both = [TRIANGLES[self.degree].lbasis(points, a) for a in range(nodes.shape[1])]
        shapes = np.stack([shape + np.zeros_like(weights) for shape, _ in both], axis=1)
        by_reference = np.stack([np.broadcast_to(d.T, (len(weights), 2)) for _, d in both], axis=1)
        # The last two barycentric coordinates are scikit-fem's on the reference triangle.
        gradients = by_reference @ linear[:, None, 1:]
        return Elements(
            self.by_dof(self._scene.vertices), self.dofs[nodes], np.outer(areas, 2 * weights), shapes, gradients
        )

    def masses(self, name: str, triangles: Ints, density: Floats) -> csr_matrix:
        """The integral of density u v over a term's triangles (k, 3), shape (size, size); density (k, 3) is linear."""
        points, weights = get_quadrature(RefTri, 5)
        nodes, areas = self.nodes_of(name, triangles), rest_gradients(self._scene.vertices, triangles)[1]
        values = [TRIANGLES[self.degree].lbasis(points, a)[0] + np.zeros_like(weights) for a in range(nodes.shape[1])]
        linear = np.stack([1.0 - points[0] - points[1], *points])
        blocks = np.einsum("m,q,mq,aq,bq->mab", areas, 2 * weights, density @ linear, values, values, optimize=True)
        dofs = self.dofs[nodes]
        rows, columns = (np.broadcast_to(side, (*blocks.shape, 3)) for side in (dofs[:, :, None], dofs[:, None]))
        entries = (np.repeat(blocks.ravel(), 3), (rows.ravel(), columns.ravel()))
        return coo_matrix(entries, shape=(self.size, self.size)).tocsr()

    def _tets(self) -> Elements:
        m, k = len(self._scene.tets), self.basis.Nbfun // 3
        first = [self.basis.basis[3 * a][0] for a in range(k)]  # of the three components the first
        gradients = np.stack([field.grad[0].transpose(1, 2, 0) for field in first], axis=2)
        points, _ = tet_rule(self.degree)
        shapes = [TETS[self.degree].lbasis(points, a)[0] + np.zeros(points.shape[1]) for a in range(k)]
        dofs = self.basis.element_dofs.T.reshape(m, k, 3).astype(np.int64)
        return Elements(self.by_dof(self._scene.vertices), dofs, self.basis.dx, np.stack(shapes, axis=1), gradients)

    def prisms(self, tets: Ints, vertices: Ints) -> tuple[Elements, Elements]:
        """Prisms of three linear tets (k, 3) with vertices (k, 6) as elements of six nodes.

        The first have one point, at which F is the mean of the tets' by volume; the second have one for each tet, at
        which "F" is that tet's less the mean.
        """
        dofs, corners = self.dofs[vertices], self.tets.dofs[tets]
        place = (corners[..., None, 0] == dofs[:, None, None, :, 0]).argmax(axis=-1)
        gradients = np.zeros((*tets.shape, 6, 3))
        np.put_along_axis(gradients, place[..., None], self.tets.gradients[tets, 0], axis=2)
        volumes = self.tets.weights[tets, 0]
        whole = volumes.sum(axis=1, keepdims=True)
        mean = np.einsum("kt,ktad->kad", volumes / whole, gradients)[:, None]
        rest, shapes = self.tets.rest, np.full((1, 6), 1 / 6)
        return (
            Elements(rest, dofs, whole, shapes, mean),
            Elements(rest, dofs, volumes, np.repeat(shapes, 3, axis=0), gradients - mean),
        )
