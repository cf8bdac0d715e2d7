"""Loops over quadrature points against FEniCSx' own assembly of the same forms."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.reference import Scene, materials, terms
from softdeca.reference.fenicsx import dolfinx_version as seam
from softdeca.reference.fenicsx import principal
from softdeca.reference.fenicsx.assembly import Stiffness
from softdeca.reference.fenicsx.numbering import Numbering
from softdeca.reference.fenicsx.problem import Problem
from softdeca.reference.fenicsx.quadrature import DEGREES, Quadrature
from softdeca.reference.problems import meshes

from .by_solver import dense
from .tangents import tangent

ufl = seam.ufl


@pytest.fixture(params=[1, 2])
def setting(request):
    """A numbering of a degree, every second cell, a displacement by node, and the measure of the cells."""
    X, tets = meshes.unstructured(2, 2.0)
    order = Numbering(Scene(X, tets, []), request.param)
    cells = np.arange(0, len(tets), 2)
    u = np.random.default_rng(0).normal(0.0, 0.1, order.X.shape)
    rule = {"quadrature_degree": DEGREES[request.param], "quadrature_scheme": "default"}
    dx = seam.cell_measure(order.space.mesh, cells)(metadata=rule)
    return order, cells, u, dx


def quadrature_space(domain, degree, shape):
    """Tensors of a shape at the points of the quadrature rule of a degree."""
    if seam.VERSION < (0, 6):
        scalar = ufl.FiniteElement("Quadrature", ufl.tetrahedron, degree, quad_scheme="default")
        return seam.fem.FunctionSpace(domain, ufl.TensorElement(scalar, shape=shape))
    import basix.ufl

    element = basix.ufl.quadrature_element("tetrahedron", value_shape=shape, scheme="default", degree=degree)
    return seam.fem.functionspace(domain, element)


def tensors(order, cells, values):
    """A function that has values (k, q, ...) at the points of some cells."""
    degree = DEGREES[order.degree]
    space = quadrature_space(order.space.mesh, degree, values.shape[2:])
    found = seam.function(space)
    dofs = seam.cell_dofs(space, values.shape[1])[cells].ravel()
    found.x.array.reshape(-1, int(np.prod(values.shape[2:])))[dofs] = values.reshape(len(dofs), -1)
    return found


def flat(v):
    gradient = ufl.grad(v)
    return ufl.as_vector([gradient[i, j] for i in range(3) for j in range(3)])


def test_deformation_gradient_is_the_displacements(setting):
    order, cells, u, _ = setting
    displacement = seam.function(order.space)
    displacement.x.array[:] = u.ravel()
    points = seam.quadrature_rule(DEGREES[order.degree])[0]
    expected = seam.evaluator(ufl.grad(displacement), points, order.space.mesh)(cells).reshape(-1, 3, 3) + np.eye(3)
    found = Quadrature(order, cells, DEGREES[order.degree]).deformation_gradient(u)
    np.testing.assert_allclose(found, expected, atol=1e-13)


def test_forces_are_the_forms(setting):
    order, cells, u, dx = setting
    quadrature = Quadrature(order, cells, DEGREES[order.degree])
    P = np.random.default_rng(1).normal(size=(len(cells), quadrature.per_cell, 3, 3))
    form = ufl.inner(tensors(order, cells, P), ufl.grad(ufl.TestFunction(order.space))) * dx
    expected = np.zeros(u.size)
    seam.add_vector(seam.compile_form(form), expected)
    found = np.zeros_like(u)
    quadrature.add_gradient(P.reshape(-1, 3, 3), found)
    np.testing.assert_allclose(found.ravel(), expected, atol=1e-13)


def test_stiffness_is_the_forms(setting):
    """By tangents as arrays, and by the modes that they come from."""
    order, cells, u, dx = setting
    quadrature = Quadrature(order, cells, DEGREES[order.degree])
    U, s, V = principal.signed_svd(quadrature.deformation_gradient(u))
    rng = np.random.default_rng(2)
    h = rng.normal(size=(len(s), 3, 3))
    modes = principal.modes(s, rng.normal(size=s.shape), h + h.transpose(0, 2, 1))
    C = tangent(U, V, modes)
    at_points = tensors(order, cells, C.reshape(len(cells), -1, 9, 9))
    v, du = ufl.TestFunction(order.space), ufl.TrialFunction(order.space)
    form = seam.compile_form(ufl.inner(ufl.dot(at_points, flat(du)), flat(v)) * dx)
    assembled = Stiffness([order.cell_dofs], order.nodes)
    seam.add_matrix(form, assembled.matrix)
    assembled.matrix.assemble()
    expected = dense(assembled.matrix)
    by_modes, by_arrays = (Stiffness([order.cell_dofs], order.nodes) for _ in range(2))
    quadrature.add_modes(U, V, modes, by_modes)
    quadrature.add_tangent(np.arange(len(C)), C, by_arrays)
    for found in (by_modes, by_arrays):
        np.testing.assert_allclose(dense(found.matrix), expected, atol=1e-12 * np.abs(expected).max())


def test_a_law_s_tangent_by_stretches_is_that_of_its_density():
    """UFL's exact Hessian, which no solve uses any more."""
    X, tets = meshes.unstructured(2, 2.0)
    law = materials.StableNeoHookean.from_young(15.0, 0.45)
    scene = Scene(X, tets, [terms.Hyperelastic(law), terms.Fixed(meshes.vertices_at(X, 2, 0.0))])
    problem = Problem(scene, Numbering(scene))
    u = np.random.default_rng(3).normal(0.0, 0.3, X.shape)  # some tets are inverted
    state = problem.at(u)
    found = dense(state.hessian())
    expected = seam.empty_matrix(problem.solids.forms[0].tangent)
    seam.add_matrix(problem.solids.forms[0].tangent, expected)
    expected.assemble()
    np.testing.assert_allclose(found, dense(expected), atol=1e-11 * np.abs(found).max())
    np.testing.assert_allclose(dense(state.hessian(np.nextafter(1.0, 0.0))), found, atol=1e-11 * np.abs(found).max())
