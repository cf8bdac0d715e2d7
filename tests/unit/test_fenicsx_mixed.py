"""Displacement and pressure: derivatives of the equations, laws in both forms, follower pressure, refusals."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

from softdeca.reference import Reason, Scene, materials, solve, terms
from softdeca.reference.fenicsx.energy.loads import FollowerPressure
from softdeca.reference.fenicsx.linear.problem import DiscreteProblem
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.fenicsx.strategies.equilibrium import Equilibrium
from softdeca.reference.problems import bars, incompressible, meshes
from softdeca.reference.problems.homogeneous import rollers

from .by_solver import solve_by

LAWS = {
    "neo-Hookean": materials.NeoHookean(1.0, 5.0),
    "stable neo-Hookean": materials.StableNeoHookean(1.0, 5.0),
    "St. Venant-Kirchhoff": materials.StVenantKirchhoff(1.0, 3.0),
    "isochoric, quadratic": materials.IsochoricNeoHookean(1.0, 5.0),
    "isochoric, logarithmic": materials.IsochoricNeoHookean(1.0, 5.0, "kappa/4 (J^2-1-2 ln J)"),
    "Mooney-Rivlin": materials.MooneyRivlin(0.3, 0.2, 5.0, C20=0.1),
}
INCOMPRESSIBLE = {
    name: materials.Incompressible(law)
    for name, law in LAWS.items()
    if name not in ("isochoric, logarithmic", "St. Venant-Kirchhoff")
}


def equations(scene, element_degree=2, mixed=True):
    problem = DiscreteProblem(scene, Numbering(scene, element_degree), mixed=mixed)
    return Equilibrium(problem, np.empty(0, dtype=np.int64))


def pulled_cube(law, stretch=1.2):
    X, tets = meshes.unstructured(2)
    far = meshes.vertices_at(X, 0, 1.0)
    held = [terms.Fixed(meshes.vertices_at(X, 0, 0.0)), terms.Fixed(far, X[far] * [stretch, 1, 1])]
    return Scene(X, tets, [terms.Hyperelastic(law), *held])


def check_derivative(scene, mixed=True, degree=2):
    """The derivative by central differences; symmetric where no pressure follows."""
    system = equations(scene, degree, mixed)
    rng = np.random.default_rng(0)
    z = 0.01 * rng.normal(size=system.count)
    d = rng.normal(size=system.count)
    h = 2e-5

    def residual(step):
        return system.at(z + step * h * d, 0.7).residual

    change = (8 * (residual(1) - residual(-1)) - (residual(2) - residual(-2))) / (12 * h)
    derivative = csr_matrix(system.derivative(system.at(z, 0.7)).getValuesCSR()[::-1])
    assert np.abs(derivative @ d - change).max() < 1e-7 * np.abs(change).max()
    return abs(derivative - derivative.T).max() / abs(derivative).max()


@pytest.mark.parametrize(
    "law", [*LAWS.values(), *INCOMPRESSIBLE.values()], ids=[*LAWS, *(f"J=1 {n}" for n in LAWS if n in INCOMPRESSIBLE)]
)
def test_the_equations_have_their_derivative(law):
    scene = pulled_cube(law)
    loaded = Scene(scene.vertices, scene.tets, [*scene.terms, terms.Gravity((0, 0, -1.0), density=0.1)])
    assert check_derivative(loaded) < 1e-12


@pytest.mark.parametrize(("degree", "mixed"), [(1, False), (2, False), (2, True)])
def test_follower_pressure_has_its_derivative(degree, mixed):
    """Not symmetric on part of a surface; symmetric on all of it, where it is a potential's."""
    scene = pulled_cube(LAWS["neo-Hookean"])
    part = meshes.triangles_at(scene.vertices, scene.tets, 2, 1.0)
    whole = meshes.boundary_triangles(scene.tets)
    for triangles, symmetric in ((part, False), (whole, True)):
        value = np.linspace(1.0, 2.0, len(triangles)) if triangles is part else 1.5
        loaded = Scene(scene.vertices, scene.tets, [*scene.terms, terms.Pressure(triangles, value)])
        assert (check_derivative(loaded, mixed, degree) < 1e-12) == symmetric


@pytest.mark.parametrize("degree", [1, 2])
def test_follower_pressure_on_a_turned_cube(degree):
    """The resultant is pressure times area against the outer normal, turned with the cube; the work is -p dV."""
    X, tets = meshes.block(2)
    scene = Scene(X, tets, [])
    order = Numbering(scene, degree)
    face = meshes.triangles_at(X, tets, 2, 1.0)
    turn = np.array([[1.0, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]]) * 2.0
    gradient = np.zeros(order.X.shape)
    FollowerPressure.from_term(terms.Pressure(face, 3.0), order.face_dofs("face", face)).add_gradient(
        order.X @ turn.T, gradient
    )
    assert np.allclose(gradient.sum(axis=0), 3.0 * 4.0 * np.array([0.0, -0.8, 0.6]), atol=1e-13)
    skin = meshes.boundary_triangles(tets)
    closed = FollowerPressure.from_term(terms.Pressure(skin, 3.0), order.face_dofs("skin", skin))
    assert closed.energy(order.X @ turn.T) == pytest.approx(3.0 * 8.0, rel=1e-13)


@pytest.mark.parametrize("linear_solver", ["mumps", "block"])
@pytest.mark.parametrize("stretch", [0.6, 1.5, 3.0])
def test_incompressible_neo_hookean_is_pulled_as_in_closed_form(stretch, linear_solver):
    """P = mu (l - 1/l²), lateral stretch 1/sqrt(l), energy mu/2 (l² + 2/l - 3)."""
    X, tets = meshes.unstructured(2)
    law = materials.Incompressible(materials.NeoHookean(2.0, 1.0))
    far = meshes.vertices_at(X, 0, 1.0)
    held = terms.Fixed(far, X[far] * [stretch, 1, 1], components=0)
    options = {"element": "P2P1", "linear_solver": linear_solver, "tolerance": 1e-10}
    solution = solve_by("fenicsx", Scene(X, tets, [terms.Hyperelastic(law), *rollers(X), held]), **options)
    assert np.allclose(solution.positions, X * [stretch, stretch**-0.5, stretch**-0.5], atol=1e-8)
    assert solution.energy == pytest.approx(1.0 * (stretch**2 + 2 / stretch - 3), rel=1e-8)
    load = terms.Traction(meshes.triangles_at(X, tets, 0, 1.0), (2.0 * (stretch - stretch**-2), 0, 0))
    if stretch > 1:
        pulled = solve_by("fenicsx", Scene(X, tets, [terms.Hyperelastic(law), *rollers(X), load]), **options)
        assert np.allclose(pulled.positions[:, 0], X[:, 0] * stretch, atol=1e-5)


@pytest.mark.parametrize("element", ["P1", "P2", "P2P1"])
def test_a_cube_under_pressure_all_round(element):
    """Follower pressure p shrinks a compressible cube to the J that its volumetric law gives: p = -U'(J)."""
    X, tets = meshes.unstructured(2)
    far = np.concatenate([meshes.triangles_at(X, tets, c, 1.0) for c in range(3)])
    law = materials.IsochoricNeoHookean(1.0, 5.0)
    scene = Scene(X, tets, [terms.Hyperelastic(law), *rollers(X), terms.Pressure(far, 5.0 * 0.2)])
    solution = solve_by("fenicsx", scene, element=element, tolerance=1e-10)
    assert np.allclose(solution.positions, X * 0.8 ** (1 / 3), atol=1e-8)


def test_a_pressure_that_is_too_much_at_once_grows_in_steps():
    """A tube under twice the pressure that its walls can bear ends at the last load that they did."""
    scene = incompressible.tube(2)
    (pressure,) = scene.of(terms.Pressure)
    held = tuple(term for term in scene.terms if term is not pressure)
    whole, most = (
        solve(
            Scene(scene.vertices, scene.tets, [*held, terms.Pressure(pressure.triangles, share * pressure.value)]),
            solver="fenicsx",
            element="P2P1",
            tolerance=1e-8,
        )
        for share in (1.0, 3.0)
    )
    assert whole.converged and most.reason is Reason.LINE_SEARCH
    assert np.isfinite(most.positions).all() and np.abs(most.positions).max() > np.abs(whole.positions).max()


@pytest.mark.parametrize("poisson", [0.45, 0.499])
def test_a_bar_drawn_far_by_its_ends_has_the_law_s_stretches(poisson):
    """Elements beside the ends snap on the way."""
    X, tets = meshes.box((6, 2, 2), (6.0, 1.0, 1.0))
    low, high = (meshes.vertices_at(X, 0, end) for end in (0.0, 6.0))
    law = materials.NeoHookean.from_young(1.0, poisson)
    drawn = [terms.Fixed(low), terms.Fixed(high, X[high] * [5.0, 1.0, 1.0])]
    solution = solve(Scene(X, tets, [terms.Hyperelastic(law), *drawn]), solver="fenicsx", element="P2P1")
    assert solution.converged, solution.reason
    middle = tets[(X[tets, 0] >= 2.0).all(axis=1) & (X[tets, 0] <= 4.0).all(axis=1)]
    rest, now = ((p[middle][:, 1:] - p[middle][:, :1]).transpose(0, 2, 1) for p in (X, solution.positions))
    stretches = np.linalg.svd(now @ np.linalg.inv(rest), compute_uv=False).mean(axis=0)
    lateral = bars.neo_hookean_law(stretches[0], poisson)[0]
    assert np.sqrt(np.prod(stretches[1:] / lateral)) == pytest.approx(1.0, abs=0.01)
