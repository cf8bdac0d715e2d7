"""The scikit-fem solver: numbering, derivatives of the whole energy, what is refused, and why it stops."""

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.spatial.transform import Rotation

from softdeca.reference import Reason, Scene, SceneError, prepare, solve
from softdeca.reference.materials import NeoHookean
from softdeca.reference.problems import meshes
from softdeca.reference.skfem.discretisation import Discretisation
from softdeca.reference.skfem.energy import Energy
from softdeca.reference.skfem.newton import solve_definite, solve_semidefinite
from softdeca.reference.terms import Fixed, Gravity, Hyperelastic, Strain, SurfaceStrain, Target, Traction, Volume


def every_term(head, rng):
    n = len(head.skin_wrap.vertices)
    half = np.arange(len(head.soft.tets))
    rest = np.arange(len(head.soft.tets), len(head.tets))
    return [
        Strain(rng.uniform(1, 5, len(half)), rng.uniform(1, 1.2, len(half)), tets=half),
        Volume(30.0, 1.1, tets=half),
        Hyperelastic(NeoHookean(2.0, 9.0), tets=rest),
        SurfaceStrain(head.skin_wrap.triangles, 40.0, 1.1),
        Target(np.arange(n), head.skin_wrap.vertices + rng.normal(size=(n, 3)), rng.uniform(5, 50, n)),
        Fixed(2 * n + np.flatnonzero(head.bone == 1)),
        Fixed(2 * n + np.flatnonzero(head.bone == 2), components=(1,)),
        Gravity((0, -9810, 0), 1e-6),
        Traction(head.skin_wrap.triangles[:5], (0.1, 0.0, 0.2)),
    ]


@pytest.fixture
def scene(sphere_head):
    return Scene(sphere_head.vertices, sphere_head.tets, every_term(sphere_head, np.random.default_rng(0)))


def test_gradient_and_hessian_are_the_derivatives_of_the_energy(scene):
    rng = np.random.default_rng(1)
    at = Discretisation(scene)
    energy = Energy(scene, at)
    x = at.flat(scene.vertices + 0.2 * rng.normal(size=scene.vertices.shape))
    d = rng.normal(size=at.size)
    h = 1e-4
    slope = (energy.value(x + h * d) - energy.value(x - h * d)) / (2 * h)
    assert np.isclose(energy.gradient(x) @ d, slope, rtol=1e-6)
    h = 1e-6  # so small that no tet crosses its strain limit
    turning = (energy.gradient(x + h * d) - energy.gradient(x - h * d)) / (2 * h)
    assert np.allclose(energy.exact_hessian(x) @ d, turning, rtol=1e-5, atol=1e-6 * np.abs(turning).max())
    assert d @ energy.projected_hessian(x) @ d >= d @ energy.exact_hessian(x) @ d


def test_energy_of_an_affine_map_is_psi_times_volume(sphere_head):
    """F is the same everywhere, in scikit-fem's numbering as in ours, also for tets in any corner order."""
    A = Rotation.random(random_state=3).as_matrix() @ np.diag([1.2, 0.9, 1.1])
    scene = Scene(sphere_head.vertices, sphere_head.tets[::-1], [Strain(2.0)])
    at = Discretisation(scene)
    expected = (0.2**2 + 0.1**2 + 0.1**2) * scene.volumes.sum()
    assert np.isclose(Energy(scene, at).value(at.flat(scene.vertices @ A.T)), expected, rtol=1e-12)


def test_solves_every_term_tightly_and_holds_what_is_fixed(scene):
    solution = solve(scene, solver="skfem", tolerance=1e-10)
    assert solution.converged
    assert solution.history.gradient_norm[-1] <= 1e-10 * solution.history.gradient_norm[0]
    held, positions = scene.dirichlet()
    assert np.array_equal(solution.positions[held], positions[held])
    assert len(solution.history.energy) == solution.iterations + 1
    assert solution.energy == solution.history.energy[-1] < solution.history.energy[0]


@pytest.mark.parametrize("place", [0, 20])
def test_vertices_of_no_tet_stay_or_follow_their_springs(place):
    """Two vertices beside a cube, numbered first or in its midst and last: one is idle, one hangs on a spring."""
    X, tets = meshes.block(2)
    X = np.vstack([X[:place], [[5.0, 5.0, 5.0]], X[place:], [[7.0, 7.0, 7.0]]])
    spring = Target([len(X) - 1], [[8.0, 7.0, 6.0]], 3.0)
    scene = Scene(X, tets + (tets >= place), [Strain(1.0), spring])
    solution = solve(scene, solver="skfem", tolerance=1e-9)
    assert solution.converged
    assert np.abs(solution.positions[:-1] - X[:-1]).max() < 1e-12
    assert np.allclose(solution.positions[-1], [8.0, 7.0, 6.0])


def test_a_free_body_turns_rigidly_to_its_targets(sphere_head):
    """Three targets that a rotation reaches: the energy is zero there, and nothing else holds the body."""
    R = Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix()
    ids = np.array([0, 5, 11])
    rest = sphere_head.vertices
    terms = [Strain(2.0), Volume(20.0), Target(ids, rest[ids] @ R.T + 3.0, 10.0)]
    solution = solve(Scene(rest, sphere_head.tets, terms), solver="skfem", tolerance=1e-9)
    assert solution.converged
    assert np.abs(solution.positions - (rest @ R.T + 3.0)).max() < 1e-6


def test_a_stretch_that_would_invert_elements_is_carried_inwards():
    """Only the boundary is told of an affine map; put there alone it inverts tets. The answer is the map."""
    X, tets = meshes.unstructured(3)
    A, shift = np.diag([3.0, 0.6, 0.8]) + 0.5 * np.eye(3, k=1), np.array([4.0, 0.0, 0.0])
    boundary = np.unique(meshes.boundary_triangles(tets))
    goal = X @ A.T + shift
    scene = Scene(X, tets, [Hyperelastic(NeoHookean(1.0, 5.0)), Fixed(boundary, goal[boundary])])
    jumped = X.copy()
    jumped[boundary] = goal[boundary]
    assert solve(scene, solver="skfem", start=jumped).reason is Reason.NOT_FINITE
    solution = solve(scene, solver="skfem", tolerance=1e-10)
    assert solution.converged
    assert np.abs(solution.positions - goal).max() < 1e-10


def test_a_twist_is_carried_in_parts_to_where_small_steps_lead():
    X, tets = meshes.box((4, 2, 2), (2.0, 1.0, 1.0))
    near, far = meshes.vertices_at(X, 0, 0.0), meshes.vertices_at(X, 0, 2.0)
    axis = np.array([0.0, 0.5, 0.5])

    def scene(degrees):
        R = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
        ends = [Fixed(near), Fixed(far, (X[far] - axis) @ R.T + axis)]
        return Scene(X, tets, [Hyperelastic(NeoHookean(1.0, 5.0)), *ends])

    at_once = solve(scene(150), solver="skfem", tolerance=1e-10)
    assert at_once.converged
    assert at_once.volume_ratio.min() > 0
    positions = X
    for degrees in range(10, 151, 10):
        positions = solve(scene(degrees), solver="skfem", start=positions, tolerance=1e-10).positions
    assert np.abs(at_once.positions - positions).max() < 1e-8


def test_prepared_takes_new_targets_and_refuses_new_stiffnesses(scene):
    prepared = prepare(scene, solver="skfem")
    target = scene.of(Target)[0]
    moved = scene.with_targets(target.positions + 1.0)
    again = prepared.solve(moved, tolerance=1e-8)
    fresh = solve(moved, solver="skfem", tolerance=1e-8)
    assert np.array_equal(again.positions, fresh.positions)
    stiffer = Scene(scene.vertices, scene.tets, [Strain(9.0), *scene.terms[1:]])
    with pytest.raises(SceneError, match="Strain"):
        prepared.solve(stiffer)


def test_says_why_it_stops(scene):
    assert solve(scene, solver="skfem", max_iterations=1).reason is Reason.MAX_ITERATIONS
    stopped = solve(scene, solver="skfem", on_iteration=lambda i, x, energy, norm: i == 2)
    assert stopped.reason is Reason.INTERRUPTED
    assert stopped.iterations == 2
    mirrored = scene.vertices * [1, 1, -1]
    refused = solve(scene, solver="skfem", start=mirrored)
    assert refused.reason is Reason.NOT_FINITE
    assert not refused.converged


@pytest.mark.parametrize(
    "options", [{"tolerance": 0.0}, {"tolerance": np.nan}, {"start": np.zeros((2, 3))}, {"element": "P9"}]
)
def test_refuses_options_out_of_range(scene, options):
    with pytest.raises(SceneError, match=next(iter(options))):
        solve(scene, solver="skfem", **options)


def test_solver_knows_definiteness():
    right = np.array([1.0, 2.0])
    definite = csc_matrix([[2.0, 1.0], [1.0, 3.0]])
    assert np.allclose(definite @ solve_definite(definite, right), right)
    assert solve_definite(csc_matrix([[1.0, 2.0], [2.0, 1.0]]), right) is None
    assert solve_definite(csc_matrix([[0.0, 1.0], [1.0, 0.0]]), right) is None
    semidefinite = csc_matrix([[1.0, 1.0], [1.0, 1.0]])
    assert np.allclose(semidefinite @ solve_semidefinite(semidefinite, np.ones(2), scale=1.0), 1.0, rtol=1e-6)


@pytest.mark.parametrize(("element", "cells"), [("P1", 3), ("P2", 2)])
def test_a_block_comes_back_from_inverted_tets(element, cells):
    """From vertices anywhere; the history shows the scene's own energy from the start on, each iteration once."""
    X, tets = meshes.block(cells)
    some = np.arange(0, len(tets), 2)
    scene = Scene(X, tets, [Strain(2.0, np.linspace(1.0, 1.1, len(some)), tets=some), Strain(0.1), Volume(20.0)])
    start = np.random.default_rng(0).uniform(-1.0, 1.0, X.shape)
    seen = []
    solution = solve(
        scene,
        solver="skfem",
        element=element,
        start=start,
        tolerance=1e-10,
        on_iteration=lambda i, x, energy, norm: seen.append(x),
    )
    assert solution.converged
    assert solution.energy < 1e-12
    assert solution.volume_ratio == pytest.approx(1.0, abs=1e-6)
    assert len(solution.history.energy) == len(seen) == solution.iterations + 1
    assert all(np.abs(a - b).max() > 0 for a, b in zip(seen[1:], seen[:-1], strict=True))
    at = Discretisation(scene, element)
    assert solution.history.energy[0] == pytest.approx(Energy(scene, at).value(at.flat(start)), rel=1e-12)


def test_a_way_out_of_inverted_tets_may_be_interrupted_and_bounded():
    X, tets = meshes.block(2)
    scene = Scene(X, tets, [Strain(1.0), Volume(20.0)])
    start = np.random.default_rng(0).uniform(-1.0, 1.0, X.shape)
    stopped = solve(scene, solver="skfem", start=start, on_iteration=lambda i, x, energy, norm: i == 2)
    assert (stopped.reason, stopped.iterations) == (Reason.INTERRUPTED, 2)
    bounded = solve(scene, solver="skfem", start=start, max_iterations=3)
    assert (bounded.reason, bounded.iterations) == (Reason.MAX_ITERATIONS, 3)
    assert len(bounded.history.energy) == 4


def test_a_body_that_nothing_holds_is_named_and_not_told_to_take_smaller_steps():
    vertices, tets = meshes.unstructured(2)
    weight = Gravity((0, 0, -9810.0), 1e-6)
    with pytest.raises(SceneError, match="nothing holds translation along x, .* of the part with vertex 0"):
        solve(Scene(vertices, tets, [Strain(1.0), weight]), solver="skfem")
