"""Stresses and reactions: closed forms, balance of forces, and the three solvers against one another."""

import pickle
from dataclasses import replace

import meshio
import numpy as np
import pytest

from softdeca.reference import Scene, materials, solve, terms, write_solution
from softdeca.reference.problems.meshes import box, triangles_at, vertices_at

from .by_solver import ELEMENTS as FEM
from .by_solver import SOLVERS, solve_by

SIZE = (3.0, 2.0, 4.0)
X, TETS = box((2, 2, 3), SIZE)
LOW, HIGH = vertices_at(X, 2, 0.0), vertices_at(X, 2, SIZE[2])
PD = (terms.Strain(3.0), terms.Volume(20.0))


def rolling(term):
    """A term on the box, which three of its sides hold in their planes."""
    return [*term, *(terms.Fixed(vertices_at(X, c, 0.0), components=c) for c in range(3))]


def stretched(term, ratio):
    top = X[HIGH] * [1.0, 1.0, ratio]
    return Scene(X, TETS, [*rolling(term), terms.Fixed(HIGH, top, components=2)])


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_bar_of_prisms_is_stretched_as_one_of_tets(solver):
    """The patch test: an affine answer and its stresses, with some tets left alone, and terms on tets of prisms."""
    prisms = np.arange(len(TETS)).reshape(-1, 6)[:, [0, 1, 4, 2, 3, 5]].reshape(-1, 3)[3:]
    rest = np.setdiff1d(np.arange(len(TETS)), prisms)
    shares = ((1.0, rest), (0.6, prisms), (0.4, prisms.ravel()))
    parts = [replace(term, stiffness=share * term.stiffness, tets=tets) for term in PD for share, tets in shares]
    by_tets = solve_by(solver, stretched(PD, 1.3))
    by_prisms = solve_by(solver, stretched([*parts, terms.Hourglass(0.3, prisms)], 1.3))
    assert by_prisms.positions == pytest.approx(by_tets.positions, abs=1e-8)
    assert by_prisms.first_piola == pytest.approx(by_tets.first_piola, abs=1e-7)
    assert by_prisms.volume_ratio == pytest.approx(by_tets.volume_ratio, abs=1e-8)


@pytest.mark.parametrize(("solver", "element"), FEM)
def test_uniaxial_stretch_of_a_neo_hookean_bar(solver, element):
    """P11 = P22 = 0 gives the contraction a: mu (a - 1/a) + lmbda ln(a² λ) / a = 0; σ33 = P33 / a²."""
    mu, lmbda, stretch = 4.0, 12.0, 1.3
    low, high = 0.5, 1.0
    for _ in range(100):
        a = 0.5 * (low + high)
        low, high = (a, high) if mu * (a - 1 / a) + lmbda * np.log(a * a * stretch) / a < 0 else (low, a)
    P33 = mu * (stretch - 1 / stretch) + lmbda * np.log(a * a * stretch) / stretch
    scene = stretched([terms.Hyperelastic(materials.NeoHookean(mu=mu, lmbda=lmbda))], stretch)
    solution = solve_by(solver, scene, element=element, tolerance=1e-10)
    P, cauchy = np.zeros((3, 3)), np.zeros((3, 3))
    P[2, 2], cauchy[2, 2] = P33, P33 / a**2
    np.testing.assert_allclose(solution.first_piola, np.broadcast_to(P, (len(TETS), 3, 3)), atol=1e-7)
    np.testing.assert_allclose(solution.cauchy, np.broadcast_to(cauchy, (len(TETS), 3, 3)), atol=1e-7)
    np.testing.assert_allclose(solution.von_mises, P33 / a**2, rtol=1e-7)
    assert solution.reactions[HIGH, 2].sum() == pytest.approx(P33 * SIZE[0] * SIZE[1], rel=1e-7)
    assert solution.reactions[LOW, 2].sum() == pytest.approx(-P33 * SIZE[0] * SIZE[1], rel=1e-7)


@pytest.mark.parametrize("solver", SOLVERS)
def test_uniaxial_stretch_by_the_energy_of_projective_dynamics(solver):
    """With Strain alone P = w (F - R): w (λ - 1) along the bar, and nothing across, which does not contract."""
    solution = solve_by(solver, stretched([terms.Strain(3.0)], 1.2), tolerance=1e-10)
    expected = np.zeros((3, 3))
    expected[2, 2] = 3.0 * 0.2
    np.testing.assert_allclose(solution.first_piola, np.broadcast_to(expected, (len(TETS), 3, 3)), atol=1e-7)
    np.testing.assert_allclose(solution.cauchy, np.broadcast_to(1.2 * expected / 1.2, (len(TETS), 3, 3)), atol=1e-7)


def bent(*more, solids=PD):
    side = triangles_at(X, TETS, 0, SIZE[0])
    held = terms.Fixed(LOW, X[LOW] + [0.1, 0.0, 0.05])
    return Scene(
        X,
        TETS,
        [*solids, held, terms.Gravity((900.0, 0, -9810.0), 1e-5), terms.Traction(side, (0.05, 0.1, 0.0)), *more],
    )


@pytest.mark.parametrize(("solver", "element"), [("projective", None), *FEM])
def test_reactions_balance_all_loads_and_their_moments(solver, element):
    """Forces, and moments about the origin of forces at the places where they act; only what is held reacts."""
    scene = bent(terms.Target(HIGH, X[HIGH] + [0.3, 0.1, 0.2], 0.2))
    options = {} if element is None else {"element": element}
    solution = solve_by(solver, scene, **options)
    springs = np.zeros_like(X)
    springs[HIGH] = 0.2 * (scene.of(terms.Target)[0].positions - solution.positions[HIGH])
    total = solution.reactions.sum(axis=0) + scene.loads().sum(axis=0) + springs.sum(axis=0)
    assert np.abs(total).max() < 1e-8 * np.abs(solution.reactions).max()
    assert not solution.reactions[np.setdiff1d(np.arange(len(X)), LOW)].any()
    if element != "P2":  # whose loads act at nodes on edges, too
        forces = solution.reactions + scene.loads() + springs
        moments = np.cross(solution.positions, forces).sum(axis=0)
        assert np.abs(moments).max() < 1e-7 * np.abs(np.cross(solution.positions, scene.loads())).max()


@pytest.mark.parametrize("element", ["P1", "P2", "P2P1"])
def test_reactions_balance_a_follower_pressure(element):
    """On a face of a closed box the resultant is p times its present area vector."""
    law = materials.NeoHookean(mu=3.0, lmbda=9.0)
    top = triangles_at(X, TETS, 2, SIZE[2])
    scene = Scene(X, TETS, [terms.Hyperelastic(law), terms.Fixed(LOW), terms.Pressure(top, 0.3)])
    solution = solve_by("fenicsx", scene, element=element)
    total = solution.reactions.sum(axis=0)
    if element == "P1":
        a, b, c = (solution.positions[top[:, k]] for k in range(3))
        assert total == pytest.approx(0.3 * 0.5 * np.cross(b - a, c - a).sum(axis=0), abs=1e-9)
    # The sides are free of load, so Cauchy's stress through the present top is its pressure but near the clamp.
    assert total[2] == pytest.approx(0.3 * SIZE[0] * SIZE[1], rel=0.1)
    above = X[TETS][:, :, 2].min(axis=1) > 2.0
    assert solution.cauchy[above, 2, 2].mean() == pytest.approx(-0.3, abs=0.03)


def test_incompressible_tissue_has_its_pressure_in_its_stress():
    """Uniaxial: σ = mu (λ² - 1/λ), whatever the pressure; without it σ33 alone would be mu (λ² - ...) off."""
    law = materials.Incompressible(materials.IsochoricNeoHookean(mu=4.0, kappa=None))
    scene = stretched([terms.Hyperelastic(law)], 1.3)
    solution = solve_by("fenicsx", scene, element="P2P1", tolerance=1e-10)
    expected = np.zeros((3, 3))
    expected[2, 2] = 4.0 * (1.3**2 - 1 / 1.3)
    np.testing.assert_allclose(solution.cauchy, np.broadcast_to(expected, (len(TETS), 3, 3)), atol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solution_is_written_with_all_that_was_found(solver, tmp_path):
    scene = bent()
    solution = solve_by(solver, scene, tolerance=1e-6)
    for name in ("answer.vtu", "answer.vtk"):
        write_solution(tmp_path / name, scene, solution)
        read = meshio.read(tmp_path / name)
        np.testing.assert_array_equal(read.points, X)
        np.testing.assert_allclose(read.point_data["displacement"], solution.positions - X)
        np.testing.assert_allclose(read.point_data["reaction"], solution.reactions)
        np.testing.assert_allclose(read.cell_data["J"][0], solution.volume_ratio)
        np.testing.assert_allclose(read.cell_data["von_mises"][0], solution.von_mises)
        np.testing.assert_allclose(read.cell_data["cauchy"][0].reshape(-1, 3, 3), solution.cauchy)
    again = pickle.loads(pickle.dumps(solve(scene, solver=solver)))
    np.testing.assert_allclose(again.cauchy, solution.cauchy, atol=1e-9)


@pytest.mark.parametrize("name", ["flat.vtu", "flat.vtk"])
def test_stresses_of_flat_tets_are_written_as_no_numbers(name, tmp_path):
    scene = Scene(X, TETS, [terms.Strain(1.0), terms.Fixed(np.arange(len(X)), X * [1.0, 1.0, 0.0])])
    write_solution(tmp_path / name, scene, solve(scene))
    written = meshio.read(tmp_path / name).cell_data
    assert np.isnan(written["von_mises"][0]).all() and np.isnan(written["cauchy"][0]).any(axis=1).all()
    assert np.isfinite(written["first_piola"][0]).all()
