"""Quadratic tets on scikit-fem: rules, nodes, what is held, loads, closed-form energies, derivatives, orders."""

from math import factorial

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq
from scipy.spatial.distance import pdist
from skfem import BilinearForm, LinearForm

from softdeca.lhm.head import CRANIUM, MANDIBLE
from softdeca.reference import Scene, SceneError, prepare, solve, terms
from softdeca.reference.materials import Corotated, NeoHookean, StVenantKirchhoff
from softdeca.reference.problems import meshes
from softdeca.reference.skfem.discretisation import Discretisation, tet_rule, triangle_rule
from softdeca.reference.skfem.energy import Energy
from softdeca.reference.skfem.solids import ByInvariants

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
    nodes = at.flat(X)[at.dofs]
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
    nodes = at.flat(X)[at.dofs]
    inside = (nodes == 0.5).all(axis=1)
    assert inside.sum() == 1
    assert np.array_equal(at.held(np.ones(X.shape, dtype=bool))[at.dofs], np.repeat(~inside[:, None], 3, axis=1))
    some = np.zeros(X.shape, dtype=bool)
    some[X[:, 0] == 0] = True
    some[X[:, 1] == 0, 2] = True
    held = at.held(some)[at.dofs]
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
    forces = -Energy(scene, at).gradient(at.flat(X))[at.dofs]
    np.testing.assert_allclose(forces, scene.loads(), rtol=0.0, atol=1e-14)


def test_quadratic_loads_work_on_quadratic_fields():
    """On u = x² e: gravity's integral over the cube and the traction's over its top, both 1/3 of it all."""
    X, tets = meshes.unstructured(2)
    top = terms.Traction(meshes.triangles_at(X, tets, 2, 1.0), (0.5, 0.0, 4.0))
    for term, load in ((terms.Gravity((0, 2.0, -3.0), density=2.0), [0, 4.0, -6.0]), (top, [0.5, 0.0, 4.0])):
        scene = Scene(X, tets, [term])
        at = Discretisation(scene, "P2")
        x = at.flat(X)
        forces = -Energy(scene, at).gradient(x)[at.dofs]
        np.testing.assert_allclose(x[at.dofs][:, 0] ** 2 @ forces, np.array(load) / 3, atol=1e-13)


def test_energy_of_a_quadratic_displacement():
    """St. Venant-Kirchhoff's is then a polynomial of degree 4, which the rule integrates exactly; so do Gauss'."""
    X, tets = meshes.unstructured(2)
    law = StVenantKirchhoff(1.3, 2.1)
    H = np.random.default_rng(0).normal(0.0, 0.2, (3, 3, 3))  # u_i = X · H_i X / 2
    scene = Scene(X, tets, [terms.Hyperelastic(law)])
    at = Discretisation(scene, "P2")
    nodes = at.flat(X)[at.dofs]
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
    nodes = at.flat(X)[at.dofs]
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


def test_gradient_and_hessian_are_derivatives():
    scene = pulled_block()
    at = Discretisation(scene, "P2")
    energy = Energy(scene, at)
    rng = np.random.default_rng(1)
    x, d = at.flat(scene.vertices) + rng.normal(0.0, 0.01, at.size), rng.normal(size=at.size)
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
    x = at.flat(X) + np.random.default_rng(2).normal(0.0, 0.02, at.size)
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


def test_patch():
    X, tets = meshes.unstructured(2)
    A = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, 0.1], [0.02, 0.0, 1.03]])
    skin = np.unique(meshes.boundary_triangles(tets))
    scene = Scene(X, tets, [terms.Strain(2.0), SOFT, terms.Fixed(skin, X[skin] @ A.T)])
    solution = solve(scene, solver="skfem", element="P2", tolerance=1e-12)
    assert solution.converged
    np.testing.assert_allclose(solution.positions, X @ A.T, atol=1e-12)


def hanging_energy(law, load, length):
    """Of a neo-Hookean column [0, length] of 1 mm² that rollers hold at its sides, pulled by `load` [mN/mm³].

    Its stress mu (J - 1/J) + lmbda ln J / J carries what hangs below, load (length - x), where J = 1 + u'. Twice
    integrated by parts, the load's potential is -∫ load (length - x) u' dx.
    """
    t, w = leggauss(40)
    total = 0.0
    for x, weight in zip(length * (t + 1) / 2, length * w / 2, strict=True):
        carried = load * (length - x)
        J = brentq(lambda J, c=carried: law.mu * (J - 1 / J) + law.lmbda * np.log(J) / J - c, 0.9, 3.0, xtol=1e-15)
        psi = law.mu / 2 * (J**2 - 1) - law.mu * np.log(J) + law.lmbda / 2 * np.log(J) ** 2
        total += weight * (psi - carried * (J - 1))
    return total


@pytest.mark.parametrize(("element", "order"), [("P1", 2), ("P2", 4)])
def test_orders_of_the_energy(element, order):
    """The energy's error is the square of the displacement's in H1, of order h² and h⁴."""
    law, load, length = NeoHookean(1.0, 2.0), 1.0, 2.0
    exact, errors = hanging_energy(law, load, length), []
    for cells in (4, 8):
        X, tets = meshes.box((cells, 1, 1), (length, 1.0, 1.0))
        walls = [terms.Fixed(meshes.vertices_at(X, c, end), components=c) for c in (1, 2) for end in (0.0, 1.0)]
        held = terms.Fixed(meshes.vertices_at(X, 0, 0.0))
        scene = Scene(X, tets, [terms.Hyperelastic(law), terms.Gravity((load, 0, 0), 1.0), held, *walls])
        solution = solve(scene, solver="skfem", element=element, tolerance=1e-12)
        assert solution.converged
        errors.append(solution.energy - exact)
    assert min(errors) > 0
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


def jaw(head):
    """Tissue drawn along by its skin, a held cranium and a free mandible, which is a tenth larger than in the scene."""
    V, n = np.array(head.vertices), len(head.bone)
    mandible = 2 * n + np.flatnonzero(head.bone == MANDIBLE)
    target = terms.Target(np.arange(n), V[:n] + [0.0, -6.0, 3.0], 5.0 * head.skin_wrap.vertex_areas)
    held = terms.Fixed(2 * n + np.flatnonzero(head.bone == CRANIUM))
    body = terms.RigidBody(mandible, V[mandible].mean(axis=0) + 1.1 * (V[mandible] - V[mandible].mean(axis=0)))
    return Scene(V, head.tets, [terms.Strain(5.0), terms.Volume(60.0), target, held, body])


def test_a_body_is_rigid_and_a_sequence_goes_on(spheres):
    """Held vertices and the body's are where they belong; a start at the answer needs its edges' nodes alone."""
    scene = jaw(spheres(1))
    prepared = prepare(scene, solver="skfem", element="P2")
    answer = prepared.solve(tolerance=1e-11)
    assert answer.converged
    body = scene.of(terms.RigidBody)[0]
    np.testing.assert_allclose(pdist(answer.positions[body.vertices]), pdist(body.rest), rtol=1e-12)
    held, places = scene.dirichlet()
    assert np.array_equal(answer.positions[held], places[held])
    again = prepared.solve(start=answer.positions, tolerance=1e-11)
    assert again.converged
    np.testing.assert_allclose(again.positions, answer.positions, atol=1e-8)
    assert answer.energy < solve(scene, solver="skfem").energy
