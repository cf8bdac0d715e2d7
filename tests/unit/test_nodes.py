"""Nodes of both finite-element solvers: where they lie, what is held, and whose faces they are."""

import numpy as np
import pytest

from softdeca.reference import Scene, terms
from softdeca.reference.materials import NeoHookean
from softdeca.reference.problems import meshes

from .by_solver import DISCRETE

X, TETS = meshes.unstructured(2)
FEM = pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
SOFT = terms.Hyperelastic(NeoHookean.from_young(1.0, 0.3))


@FEM
def test_quadratic_elements_have_a_node_per_vertex_and_edge(solver):
    """They lie where the library has them; a face finds those of its corners, then those on its sides."""
    discrete = DISCRETE[solver](Scene(X, TETS, []), "P2")
    pairs = TETS[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    expected = np.concatenate([X, X[edges].mean(axis=1)])
    nodes = discrete.nodes
    assert len(nodes) == len(expected)
    np.testing.assert_allclose(nodes[np.lexsort(nodes.T)], expected[np.lexsort(expected.T)], atol=1e-14)
    if solver == "skfem":
        at = discrete.discretisation
        for c in range(3):
            np.testing.assert_allclose(at.basis.doflocs[:, at.dofs[:, c]].T, nodes, atol=1e-14)
    else:
        np.testing.assert_allclose(discrete.order.space.tabulate_dof_coordinates(), nodes, atol=1e-14)
        assert np.array_equal(nodes[discrete.order.dof], X)
    triangles = meshes.boundary_triangles(TETS)
    of_faces = nodes[discrete.face_nodes(triangles)]
    np.testing.assert_allclose(of_faces[:, :3], X[triangles], atol=1e-14)
    sides = {"skfem": ((0, 1), (1, 2), (0, 2)), "fenicsx": ((1, 2), (0, 2), (0, 1))}[solver]
    for k, side in enumerate(sides):
        np.testing.assert_allclose(of_faces[:, 3 + k], X[triangles[:, side]].mean(axis=1), atol=1e-14)


def test_linear_nodes_of_fenicsx_are_the_vertices_of_tets():
    X, tets = meshes.unstructured(3)
    spare = np.concatenate([[[9.0, 9.0, 9.0]], X])  # a vertex in no tet
    scene = Scene(spare, tets + 1, [SOFT])
    order = DISCRETE["fenicsx"](scene).order
    assert np.array_equal(order.X, spare[order.vertex]) and order.dof[0] == -1
    assert np.array_equal(order.dof[order.vertex], np.arange(len(X)))
    corners = np.sort(order.vertex[order.cell_dofs], axis=1)
    assert np.array_equal(corners, np.sort(scene.tets[order.tet], axis=1))
    geometry = order.space.mesh.geometry.x[:, :3]
    assert np.array_equal(np.sort(geometry, axis=0), np.sort(X, axis=0))
    values = np.random.default_rng(0).normal(size=spare.shape)
    assert np.array_equal(order.to_scene(order.to_dofs(values), np.zeros_like(values))[1:], values[1:])


@FEM
def test_an_edge_through_the_inside_is_free_between_held_faces(solver):
    """All vertices of a cube of one cell are held, or two sides in other components; the diagonal's middle is not."""
    X, tets = meshes.block(1)
    discrete = DISCRETE[solver](Scene(X, tets, []), "P2")
    nodes = discrete.nodes
    inside = (nodes == 0.5).all(axis=1)
    assert inside.sum() == 1
    assert np.array_equal(discrete.held(np.ones(X.shape, dtype=bool)), np.repeat(~inside[:, None], 3, axis=1))
    some = np.zeros(X.shape, dtype=bool)
    some[X[:, 0] == 0] = True
    some[X[:, 1] == 0, 2] = True
    held = discrete.held(some)
    assert np.array_equal(held[:, 1], nodes[:, 0] == 0)
    assert np.array_equal(held[:, 2], (nodes[:, 0] == 0) | (nodes[:, 1] == 0))
