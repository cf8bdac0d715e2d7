"""scikit-fem's discretisation and energy: rules, nodes, what is held, loads, closed-form energies, derivatives."""

from math import factorial

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.spatial.transform import Rotation
from skfem import BilinearForm, LinearForm

from softdeca.reference import Scene, SceneError, solve, terms
from softdeca.reference.materials import Corotated, NeoHookean, StVenantKirchhoff
from softdeca.reference.problems import meshes
from softdeca.reference.skfem.discretisation import Discretisation, tet_rule, triangle_rule
from softdeca.reference.skfem.energy import Energy
from softdeca.reference.skfem.solids import ByInvariants, project_spd
from softdeca.reference.skfem.surfaces import Bends

SOFT = terms.Hyperelastic(NeoHookean.from_young(1.0, 0.3))


@pytest.mark.parametrize("rule", [tet_rule, triangle_rule])
@pytest.mark.parametrize(("degree", "exact"), [(1, 1), (2, 4)])
def test_rules_integrate_polynomials(rule, degree, exact):
    """Over the reference simplex of d dimensions x^a y^b z^c integrates to a! b! c! / (a + b + c + d)!."""
    points, weights = rule(degree)
    assert weights.min() > 0
    d = len(points)
    for powers in np.ndindex(*(d * [exact + 1])):
        if sum(powers) <= exact:
            expected = np.prod([float(factorial(p)) for p in powers]) / factorial(sum(powers) + d)
            found = weights @ np.prod(points.T ** np.array(powers), axis=1)
            assert found == pytest.approx(expected, rel=1e-13)


def test_nodes_lie_where_scikit_fem_has_them():
    X, tets = meshes.unstructured(2)
    at = Discretisation(Scene(X, tets, []), "P2")
    edges = np.unique(np.sort(tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1), axis=0)
    assert len(at.dofs) == len(X) + len(edges)
    nodes = at.by_dof(X)[at.dofs]
    for c in range(3):
        np.testing.assert_allclose(at.basis.doflocs[:, at.dofs[:, c]].T, nodes, atol=1e-14)
    triangles = meshes.boundary_triangles(tets)
    found = at.nodes_of("faces", triangles)
    a, b, c = X[triangles].transpose(1, 0, 2)
    expected = np.stack([a, b, c, (a + b) / 2, (b + c) / 2, (a + c) / 2], axis=1)
    np.testing.assert_allclose(nodes[found], expected, atol=1e-14)


@pytest.mark.parametrize("kind", [terms.Traction, terms.SurfaceStrain])
def test_refuses_a_triangle_inside_a_tet(kind):
    X, tets = meshes.unstructured(2)
    across = np.array([[0, 1, 26]])
    term = terms.Traction(across, (1.0, 0, 0)) if kind is terms.Traction else terms.SurfaceStrain(across, 1.0)
    scene = Scene(X, tets, [SOFT, term, terms.Fixed([0, 1, 2, 8])])
    assert solve(scene, solver="skfem", max_iterations=0).iterations == 0
    with pytest.raises(SceneError, match=f"{term.name}: triangle 0 is no face of a tet"):
        solve(scene, solver="skfem", element="P2")


def test_an_edge_through_the_inside_is_free_between_held_faces():
    """Of a cube of one cell all vertices are held, or two sides in other components; the diagonal's middle is not."""
    X, tets = meshes.block(1)
    at = Discretisation(Scene(X, tets, []), "P2")
    nodes = at.by_dof(X)[at.dofs]
    inside = (nodes == 0.5).all(axis=1)
    assert inside.sum() == 1
    assert np.array_equal(at.held_dofs(np.ones(X.shape, dtype=bool))[at.dofs], np.repeat(~inside[:, None], 3, axis=1))
    some = np.zeros(X.shape, dtype=bool)
    some[X[:, 0] == 0] = True
    some[X[:, 1] == 0, 2] = True
    held = at.held_dofs(some)[at.dofs]
    assert np.array_equal(held[:, 1], nodes[:, 0] == 0)
    assert np.array_equal(held[:, 2], (nodes[:, 0] == 0) | (nodes[:, 1] == 0))


def loaded(X, tets):
    return [
        terms.Gravity((0.2, -1.0, 3.0), density=np.linspace(1.0, 2.0, len(tets))),
        terms.Gravity((1.0, 0.0, 0.0), density=0.5, tets=[3, 1]),
        terms.Traction(meshes.triangles_at(X, tets, 2, 1.0), (0.5, 0.0, 4.0)),
    ]


def test_linear_loads_are_the_scenes():
    X, tets = meshes.unstructured(2)
    scene = Scene(X, tets, loaded(X, tets))
    at = Discretisation(scene)
    forces = -Energy(scene, at).gradient(at.by_dof(X))[at.dofs]
    np.testing.assert_allclose(forces, scene.loads(), rtol=0.0, atol=1e-14)


def test_quadratic_loads_work_on_quadratic_fields():
    """On u = x² e: gravity's integral over the cube and the traction's over its top, both 1/3 of it all."""
    X, tets = meshes.unstructured(2)
    top = terms.Traction(meshes.triangles_at(X, tets, 2, 1.0), (0.5, 0.0, 4.0))
    for term, load in ((terms.Gravity((0, 2.0, -3.0), density=2.0), [0, 4.0, -6.0]), (top, [0.5, 0.0, 4.0])):
        scene = Scene(X, tets, [term])
        at = Discretisation(scene, "P2")
        x = at.by_dof(X)
        forces = -Energy(scene, at).gradient(x)[at.dofs]
        np.testing.assert_allclose(x[at.dofs][:, 0] ** 2 @ forces, np.array(load) / 3, atol=1e-13)


def test_energy_of_a_quadratic_displacement():
    """St. Venant-Kirchhoff's is then a polynomial of degree 4, which the rule integrates exactly; so do Gauss'."""
    X, tets = meshes.unstructured(2)
    law = StVenantKirchhoff(1.3, 2.1)
    H = np.random.default_rng(0).normal(0.0, 0.2, (3, 3, 3))  # u_i = X · H_i X / 2
    scene = Scene(X, tets, [terms.Hyperelastic(law)])
    at = Discretisation(scene, "P2")
    nodes = at.by_dof(X)[at.dofs]
    x = np.empty(at.size)
    x[at.dofs] = nodes + np.einsum("ijk,nj,nk->ni", H, nodes, nodes) / 2
    t, w = leggauss(3)
    t, w = (t + 1) / 2, w / 2
    expected = 0.0
    for place in np.ndindex(3, 3, 3):
        F = np.eye(3) + np.einsum("ijk,j->ik", (H + H.transpose(0, 2, 1)) / 2, t[list(place)])
        E = (F.T @ F - np.eye(3)) / 2
        expected += np.prod(w[list(place)]) * (law.mu * np.sum(E**2) + law.lmbda / 2 * np.trace(E) ** 2)
    assert Energy(scene, at).value(x) == pytest.approx(expected, rel=1e-12)


def test_membrane_of_a_quadratic_stretch():
    """On u = (a x²/2, b y²/2, 0) the stretches of z = 1 are 1 + a x and 1 + b y: w/2 (a² + b²)/3 per mm²."""
    X, tets = meshes.unstructured(2)
    surface = terms.SurfaceStrain(meshes.triangles_at(X, tets, 2, 1.0), 3.0)
    scene = Scene(X, tets, [surface])
    at = Discretisation(scene, "P2")
    nodes = at.by_dof(X)[at.dofs]
    x = np.empty(at.size)
    x[at.dofs] = nodes + nodes**2 * np.array([0.4, 0.3, 0.0]) / 2
    assert Energy(scene, at).value(x) == pytest.approx(1.5 * (0.16 + 0.09) / 3, rel=1e-12)


def pulled_block():
    X, tets = meshes.unstructured(2)
    skin, top = meshes.boundary_triangles(tets), meshes.vertices_at(X, 2, 1.0)
    some = np.arange(0, len(tets), 2)
    energies = [
        terms.Strain(np.linspace(1.0, 2.0, len(some)), 1.02, tets=some),
        terms.Volume(np.linspace(5.0, 9.0, len(tets)), 1.1),
        terms.Hyperelastic(Corotated(1.0, 2.0), tets=some[::-1]),
        SOFT,
        terms.SurfaceStrain(skin, np.linspace(1.0, 2.0, len(skin)), growth=1.1, rest=X * [1.0, 1.1, 0.9]),
        terms.Bending(meshes.triangles_at(X, tets, 1, 1.0), 0.3),
        terms.Inertia(1e-4, 0.01),
        terms.Target(top, X[top] + [0.2, 0.3, 0.1], 0.7),
        terms.Fixed(meshes.vertices_at(X, 2, 0.0)),
    ]
    return Scene(X, tets, [*energies, *loaded(X, tets)])


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_gradient_and_hessian_are_derivatives(element):
    scene = pulled_block()
    at = Discretisation(scene, element)
    energy = Energy(scene, at)
    rng = np.random.default_rng(1)
    x, d = at.by_dof(scene.vertices) + rng.normal(0.0, 0.01, at.size), rng.normal(size=at.size)
    h = 1e-6
    slope = (energy.value(x + h * d) - energy.value(x - h * d)) / (2 * h)
    assert energy.gradient(x) @ d == pytest.approx(slope, rel=1e-6)
    turning = (energy.gradient(x + h * d) - energy.gradient(x - h * d)) / (2 * h)
    found = energy.exact_hessian(x) @ d
    np.testing.assert_allclose(found, turning, rtol=0.0, atol=1e-5 * np.abs(turning).max())
    projected = energy.projected_hessian(x).toarray()
    assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(projected).max()


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_assembly_is_scikit_fems(element):
    """Forces and stiffness of one law against scikit-fem's own assembly of its weak forms."""
    X, tets = meshes.unstructured(2)
    scene = Scene(X, tets, [SOFT])
    at = Discretisation(scene, element)
    x = at.by_dof(X) + np.random.default_rng(2).normal(0.0, 0.02, at.size)
    law = ByInvariants(SOFT.material)

    def at_points(w):
        return np.moveaxis(w["x"].grad, (0, 1), (-2, -1)).reshape(-1, 3, 3)

    @LinearForm
    def work(v, w):
        stress = law.stress(at_points(w)).reshape(*w["x"].grad.shape[2:], 3, 3)
        return np.einsum("mqij,ijmq->mq", stress, v.grad)

    @BilinearForm
    def stiffness(u, v, w):
        tangent = law.tangent(at_points(w)).reshape(*w["x"].grad.shape[2:], 3, 3, 3, 3)
        return np.einsum("mqijkl,ijmq,klmq->mq", tangent, v.grad, u.grad)

    energy, place = Energy(scene, at), at.basis.interpolate(x)
    forces = work.assemble(at.basis, x=place)
    np.testing.assert_allclose(energy.gradient(x), forces, rtol=0.0, atol=1e-13 * np.abs(forces).max())
    expected = stiffness.assemble(at.basis, x=place).toarray()
    found = energy.exact_hessian(x).toarray()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


def test_energy_of_an_affine_map_is_psi_times_volume(sphere_head):
    """F is the same everywhere, in scikit-fem's numbering as in ours, also for tets in any corner order."""
    A = Rotation.random(random_state=3).as_matrix() @ np.diag([1.2, 0.9, 1.1])
    scene = Scene(sphere_head.vertices, sphere_head.tets[::-1], [terms.Strain(2.0)])
    at = Discretisation(scene)
    expected = (0.2**2 + 0.1**2 + 0.1**2) * scene.volumes.sum()
    assert np.isclose(Energy(scene, at).value(at.by_dof(scene.vertices @ A.T)), expected, rtol=1e-12)


def bent_side():
    """A block with Bending on one of its sides, positions far from rest, and the term's part of the energy."""
    rng = np.random.default_rng(0)
    X, tets = meshes.unstructured(4, 4.0)
    triangles = meshes.triangles_at(X, tets, 2, 4.0)
    X = X + rng.normal(0.0, 0.05, X.shape)
    term = terms.Bending(triangles, rng.uniform(1.0, 2.0, len(triangles)))
    scene = Scene(X, tets, [term])
    at = Discretisation(scene)
    return Bends(scene, term, at), at, X, at.by_dof(X + rng.normal(0.0, 0.2, X.shape))


def test_bending_derivatives():
    part, _, _, x = bent_side()
    d, h = np.random.default_rng(1).normal(size=x.shape), 1e-5
    gradient = part.gradient(x)
    assert (part.value(x + h * d) - part.value(x - h * d)) / (2 * h) == pytest.approx(gradient @ d, rel=1e-7)
    expected = (part.gradient(x + h * d) - part.gradient(x - h * d)) / (2 * h)
    found = part.hessian(x, lambda tangent: tangent) @ d
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())
    values = np.linalg.eigvalsh(part.hessian(x, project_spd).toarray())
    assert values.min() > -1e-10 * values.max()


def test_bending_knows_rigid_motions():
    part, at, X, x = bent_side()
    turn = Rotation.from_rotvec([2.0, -1.0, 0.3])
    assert part.value(at.by_dof(turn.apply(X) + 4.0)) < 1e-20 < part.value(x)
    assert part.value(at.by_dof(turn.apply(x[at.dofs]) + 4.0)) == pytest.approx(part.value(x), rel=1e-10)


def test_surface_seeks_another_rest_shape():
    """F is measured from `rest`, the area from the scene: a block's side 1.2 times as large in rest, all held."""
    X, tets = meshes.unstructured(3, 2.0)
    triangles = meshes.triangles_at(X, tets, 2, 2.0)
    term = terms.SurfaceStrain(triangles, 3.0, 1.1, rest=1.2 * X)
    answer = solve(Scene(X, tets, [term, terms.Fixed(np.arange(len(X)))]), solver="skfem", max_iterations=0)
    assert answer.energy == pytest.approx(0.5 * 3.0 * 4.0 * 2.0 * (1 / 1.2 - np.sqrt(1.1)) ** 2, rel=1e-12)
