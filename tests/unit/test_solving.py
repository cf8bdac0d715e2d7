"""Promises of every solver's solve: its history, why it stopped, a sequence prepared once, refusals."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from softdeca.lhm.base.errors import MissingDependencyError
from softdeca.reference import Reason, Scene, SceneError, materials, terms
from softdeca.reference.problems import meshes
from softdeca.reference.solution import least_quadratic_ratio

from ..refusals import refused
from .by_solver import ELEMENTS, SOLVERS, WAYS, element_options, prepare_by, solve_by

X, TETS = meshes.unstructured(2)
SOFT = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.3))
LOW, HIGH = (meshes.vertices_at(X, 2, at) for at in (0.0, 1.0))
each_way = pytest.mark.parametrize(("solver", "element"), WAYS)
each_solver = pytest.mark.parametrize("solver", SOLVERS)


def pulled_block(*more):
    """Energies, springs and loads that all solvers model, on a block with a held foot."""
    some, skin = np.arange(0, len(TETS), 2), meshes.boundary_triangles(TETS)
    return Scene(
        X,
        TETS,
        [
            terms.Strain(np.linspace(1.0, 2.0, len(some)), 1.02, tets=some),
            terms.Strain(0.5),
            terms.Volume(np.linspace(5.0, 9.0, len(TETS)), 1.1),
            terms.SurfaceStrain(skin, np.linspace(1.0, 2.0, len(skin)), growth=1.1, rest=X * [1.0, 1.1, 0.9]),
            terms.Target(HIGH, X[HIGH] + [0.2, 0.3, 0.1], 0.7),
            terms.Fixed(LOW),
            terms.Gravity((0.2, -1.0, 3.0), density=np.linspace(0.1, 0.2, len(TETS))),
            terms.Traction(meshes.triangles_at(X, TETS, 2, 1.0), (0.05, 0.0, 0.4)),
            *more,
        ],
    )


@each_way
def test_every_term_is_solved_tightly_and_each_iteration_told(solver, element):
    seen, scene = [], pulled_block()

    def see(i, x, energy, norm):
        seen.append((i, x, energy, norm))

    answer = solve_by(solver, scene, tolerance=1e-10, on_iteration=see, **element_options(solver, element))
    history = answer.history
    assert history.gradient_norm[-1] <= 1e-10 * history.gradient_norm[0]
    held, positions = scene.dirichlet()
    assert np.array_equal(answer.positions[held], positions[held])
    assert len(history.energy) == len(history.time) == answer.iterations + 1
    assert answer.energy == history.energy[-1] < history.energy[0]
    assert [i for i, *_ in seen] == list(range(answer.iterations + 1))
    np.testing.assert_allclose(seen[0][1], X, atol=1e-15)
    np.testing.assert_allclose(seen[-1][1], answer.positions, atol=1e-12)
    assert seen[-1][2:] == (answer.energy, history.gradient_norm[-1])
    assert all(np.abs(after[1] - before[1]).max() > 0 for before, after in zip(seen[:-1], seen[1:], strict=True))


@each_way
@pytest.mark.filterwarnings("ignore:overflow")
def test_a_solve_says_why_it_stops(solver, element):
    prepared = prepare_by(solver, pulled_block(), **element_options(solver, element))
    for limit in (0, 1, 2):
        bounded = prepared.solve(max_iterations=limit, tolerance=1e-12)
        assert (bounded.reason, bounded.iterations) == (Reason.MAX_ITERATIONS, limit)
        assert len(bounded.history.energy) == limit + 1
    stopped = prepared.solve(on_iteration=lambda i, x, energy, norm: i == 2)
    assert (stopped.reason, stopped.iterations) == (Reason.INTERRUPTED, 2)
    lost = [prepared.solve(start=X * 1e200)]
    if solver != "projective":  # whose energies are finite wherever floating point is
        scene = Scene(X, TETS, [SOFT, terms.Fixed(LOW)])
        lost += [prepare_by(solver, scene, element=element).solve(start=X * [1.0, 1.0, -1.0])]
    assert all(answer.reason is Reason.NOT_FINITE and not answer.converged for answer in lost)


@each_solver
def test_what_is_prepared_can_be_pickled_or_says_that_it_cannot(solver):
    prepared = prepare_by(solver, pulled_block())
    if solver == "fenicsx":
        for copied in (pickle.dumps, copy.deepcopy):
            refused("cannot be copied or pickled", copied, prepared, error=SceneError)
        return
    again = pickle.loads(pickle.dumps(prepared)).solve()
    np.testing.assert_allclose(again.positions, prepared.solve().positions, atol=1e-12)


@each_way
@pytest.mark.parametrize("stiffness", [1e12, 1e18])
def test_a_small_load_is_solved_for_beside_great_stiffness(solver, element, stiffness):
    """Springs so stiff hold like Fixed; what rounding in them hides says so by its reason."""
    soft, foot = [terms.Strain(10.0), terms.Gravity((0, 0, -9810.0), 1e-5)], meshes.triangles_at(X, TETS, 2, 0.0)
    options = element_options(solver, element)
    fixed = solve_by(solver, Scene(X, TETS, [*soft, terms.Fixed(LOW)]), tolerance=1e-9, **options).positions
    springs = terms.Target(LOW, X[LOW], stiffness, foot)
    answer = prepare_by(solver, Scene(X, TETS, [*soft, springs]), **options).solve(tolerance=1e-9)
    first, *_, last = answer.history.gradient_norm
    assert (answer.reason is Reason.CONVERGED) == (last <= 1e-9 * first)
    assert answer.converged or answer.reason is Reason.STAGNATED
    share = 1e-5 if element == "P1" else 2e-3  # quadratic springs are spread otherwise than nodes are held
    assert np.abs(answer.positions - fixed).max() < share * np.abs(fixed - X).max()


CLAMPED = terms.Fixed(np.concatenate([LOW, HIGH]), np.vstack([X[LOW], X[HIGH] - [0, 0, 0.9]]))
LAWS = {"St. Venant-Kirchhoff": materials.StVenantKirchhoff, "neo-Hookean": materials.NeoHookean}


@pytest.mark.parametrize(("solver", "element"), ELEMENTS)
@pytest.mark.parametrize("law", LAWS)
def test_no_answer_is_inside_out_and_called_converged(solver, element, law):
    """A clamped cube pressed by 90 % in one go: a law without an energy there keeps linear tets, not quadratic ones."""
    scene = Scene(X, TETS, [terms.Hyperelastic(LAWS[law].from_young(1.0, 0.3)), CLAMPED])
    answer = prepare_by(solver, scene, element=element).solve(max_iterations=300)
    assert answer.converged == (answer.is_balanced and not answer.inverted.any())
    if (law, element) == ("neo-Hookean", "P1"):
        assert answer.converged
    else:
        assert answer.reason is Reason.INVERTED or not answer.is_balanced


def test_the_least_volume_ratio_of_a_quadratic_tet_is_its_polynomials():
    """x -> x (1 - a x): J = 1 - 2 a x, least at x = 1, where linear tets have 1 - a."""
    corners, tets = meshes.block(1)
    ends = np.array([(i, j) for i in range(len(corners)) for j in range(i + 1)])
    bend = lambda x: x * np.where(np.arange(3) == 0, 1.0 - 0.7 * x[:, :1], 1.0)  # noqa: E731
    scene = Scene(corners, tets, [terms.Strain(1.0)])
    least = least_quadratic_ratio(scene, bend(corners), ends, bend(corners[ends].mean(axis=1)))
    np.testing.assert_allclose(least, 1.0 - 1.4 * corners[tets][:, :, 0].max(axis=1), atol=1e-12)


@each_way
def test_a_sequence_is_prepared_once(solver, element):
    """Other targets and held positions in a prepared scene give what a new preparation gives."""
    scene, options = pulled_block(), element_options(solver, element)
    (target,) = scene.of(terms.Target)
    other = scene.with_targets(target.positions + [0.1, -0.4, 0.0]).with_fixed(X[LOW] + [0.0, 0.1, 0.0])
    prepared = prepare_by(solver, scene, **options)
    prepared.solve()
    again = prepared.solve(other, tolerance=1e-11)
    assert again.converged
    assert np.abs(again.positions - solve_by(solver, other, **options).positions).max() < 1e-8


@each_way
def test_threads_share_a_prepared_scene(solver, element):
    scene, options = pulled_block(), element_options(solver, element)
    (target,) = scene.of(terms.Target)
    scenes = [scene.with_targets(target.positions + [0.0, 0.0, 0.1 * k]) for k in range(8)]
    prepared = prepare_by(solver, scene, **options)
    alone = [prepared.solve(each, tolerance=1e-9).positions for each in scenes]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda each: prepared.solve(each, tolerance=1e-9).positions, scenes))
    np.testing.assert_allclose(together, alone, atol=1e-7)


@each_way
@pytest.mark.parametrize("place", [0, 20])
def test_vertices_of_no_tet_stay_or_are_held(solver, element, place):
    """Three vertices beside a cube, numbered first or in its midst, and last; springs pull one where they may."""
    cube, tets = meshes.block(2)
    points = np.vstack([cube[:place], [[5.0, 5.0, 5.0]], cube[place:], [[6.0, 6.0, 6.0], [7.0, 7.0, 7.0]]])
    last = len(points) - 1
    held = terms.Fixed([last - 1], [[7.0, 7.0, 7.0]])
    scene = Scene(points, tets + (tets >= place), [terms.Strain(1.0), held])
    options = element_options(solver, element)
    expected = points.copy()
    expected[last - 1] = 7.0
    np.testing.assert_allclose(solve_by(solver, scene, tolerance=1e-9, **options).positions, expected, atol=1e-12)
    pulled = Scene(points, scene.tets, [*scene.terms, terms.Target([last], [[8.0, 7.0, 6.0]], 3.0)])
    if solver == "fenicsx":
        with pytest.raises(SceneError, match=f"Target: vertex {last} is in no tet"):
            prepare_by(solver, pulled, **options)
        return
    expected[last] = [8.0, 7.0, 6.0]
    np.testing.assert_allclose(solve_by(solver, pulled, tolerance=1e-9, **options).positions, expected, atol=1e-8)


WEIGHT = terms.Gravity((0, -9810.0, 0), 1e-6)
PULL = terms.Traction(meshes.triangles_at(X, TETS, 1, 1.0), (0.15, 0.2, 0.3))
FREE = [
    ("projective", {}, [terms.Strain(1.0), WEIGHT], "nothing holds the part around vertex 0 along y"),
    ("skfem", {}, [terms.Strain(1.0), WEIGHT], "nothing holds translation along x, .* of the part with vertex 0"),
    *(
        ("fenicsx", {"element": element}, [SOFT, PULL, *held], message)
        for element in ("P1", "P2P1")
        for held, message in (
            ([], "translation along x, translation along y, translation along z, rotation about x"),
            (
                [terms.Fixed([0])],
                "holds rotation about x, rotation about y, .* of the part with vertex 0",
            ),
            ([terms.Fixed([0, 2])], "holds rotation about z of"),
            ([terms.Fixed(np.arange(4), components=(0, 2))], "holds translation along y of"),
        )
    ),
]


@pytest.mark.parametrize(("solver", "options", "parts", "message"), FREE)
def test_free_rigid_motions_under_a_load_are_named(solver, options, parts, message):
    with pytest.raises(SceneError, match=message):
        prepare_by(solver, Scene(X, TETS, parts), **options).solve()


@each_solver
def test_balanced_loads_on_a_free_block_stretch_it(solver):
    """Strain only: P = ws (stretch - 1); how it turns is free."""
    pull = [terms.Traction(meshes.triangles_at(X, TETS, 0, end), (0.4 * end - 0.2, 0, 0)) for end in (0.0, 1.0)]
    answer = solve_by(solver, Scene(X, TETS, [terms.Strain(1.0), *pull]))
    np.testing.assert_allclose(pdist(answer.positions), pdist(X * [1.2, 1.0, 1.0]), atol=1e-8)


def test_unknown_versions_are_refused_in_one_line():
    pytest.importorskip("dolfinx")
    from softdeca.reference.fenicsx.dolfinx_version import parse_version

    assert parse_version("0.5.2") == (0, 5) and parse_version("0.11.0.post0") == (0, 11)
    for version in ("0.4.1", "0.12.0", "1.0.0"):
        with pytest.raises(MissingDependencyError, match=f"dolfinx {version} is installed; softdeca knows 0.5 to 0.11"):
            parse_version(version)
