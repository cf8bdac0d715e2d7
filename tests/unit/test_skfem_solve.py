"""The scikit-fem solver: what it reaches, what is refused, why it stops, orders of convergence, and rigid bodies."""

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq
from scipy.sparse import csc_matrix
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from softdeca.lhm.head import CRANIUM, MANDIBLE
from softdeca.reference import Reason, Scene, SceneError, prepare, solve, terms
from softdeca.reference.materials import NeoHookean
from softdeca.reference.problems import meshes
from softdeca.reference.skfem.discretisation import Discretisation
from softdeca.reference.skfem.energy import Energy
from softdeca.reference.skfem.newton import solve_definite, solve_semidefinite
from softdeca.reference.skfem.unknowns import Body, Unknowns
from softdeca.reference.terms import Fixed, Gravity, Hyperelastic, Strain, Target, Volume

from .test_skfem_energy import pulled_block


@pytest.fixture(scope="module")
def scene():
    return pulled_block()


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
    assert solution.history.energy[0] == pytest.approx(Energy(scene, at).value(at.by_dof(start)), rel=1e-12)


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


def jaw_scene(head, *more, scale=1.0):
    """Tissue pulled by a skin whose lower part turns, a held cranium, and a free mandible `scale` times its size."""
    V, n = np.array(head.vertices), len(head.bone)
    turned = Rotation.from_euler("x", 15.0, degrees=True).apply(V[:n])
    share = np.clip((-V[:n, 1] - 20.0) / 40.0, 0.0, 1.0)[:, None]
    mandible = 2 * n + np.flatnonzero(head.bone == MANDIBLE)
    centre = V[mandible].mean(axis=0)
    body = terms.RigidBody(mandible, centre + scale * (V[mandible] - centre))
    held = terms.Fixed(2 * n + np.flatnonzero(head.bone == CRANIUM))
    target = terms.Target(np.arange(n), V[:n] + share * (turned - V[:n]), 5.0 * head.skin_wrap.vertex_areas)
    return Scene(V, head.tets, [terms.Strain(5.0), terms.Volume(60.0), target, held, body, *more])


@pytest.fixture(scope="module")
def turned(sphere_head):
    """An energy, its unknowns, and positions with the body turned far and the tissue disturbed."""
    scene = jaw_scene(sphere_head)
    at = Discretisation(scene)
    bodies = Body.from_scene(scene, at)
    free = ~at.held_dofs(scene.dirichlet()[0])
    free[bodies[0].dofs] = False
    unknowns = Unknowns(np.flatnonzero(free), at.size, bodies)
    step = np.random.default_rng(3).normal(0.0, 1.0, unknowns.count)
    step[-3:] *= 20.0
    return Energy(scene, at), unknowns, unknowns.move(at.by_dof(scene.vertices), step)


def reduced_gradient(energy, unknowns, x):
    return unknowns.gradient(x, energy.gradient(x))


def test_gradient_over_the_unknowns(turned):
    energy, unknowns, x = turned
    gradient = reduced_gradient(energy, unknowns, x)
    for seed in range(3):
        d = np.random.default_rng(seed).normal(size=unknowns.count)
        d[:-6] *= seed
        ahead, behind = (energy.value(unknowns.move(x, h * d)) for h in (1e-4, -1e-4))
        assert (ahead - behind) / 2e-4 == pytest.approx(gradient @ d, rel=1e-6)


def test_hessian_over_the_unknowns(turned):
    """Along s w the Cayley turn is by 2 atan(s |w| / 2ρ), so the slope is gradient · d, its turn over 1 + |s w / 2ρ|².

    At s = h that factor is 1 + O(h²) and even: the difference ahead and behind does not see it.
    """
    energy, unknowns, x = turned
    H = unknowns.hessian(x, energy.gradient(x), energy.exact_hessian(x)).toarray()
    np.testing.assert_allclose(H, H.T, rtol=0.0, atol=1e-12 * np.abs(H).max())
    for seed in range(3):
        d = np.random.default_rng(seed).normal(size=unknowns.count)
        d[:-6] *= seed
        moved = [unknowns.move(x, h * d) for h in (1e-4, -1e-4)]
        ahead, behind = (reduced_gradient(energy, unknowns, y) @ d for y in moved)
        assert (ahead - behind) / 2e-4 == pytest.approx(d @ H @ d, rel=1e-6)


def test_projected_hessian_is_semidefinite(turned):
    energy, unknowns, x = turned
    projected = unknowns.projected_hessian(x, energy.gradient(x), energy.projected_hessian(x)).toarray()
    values = np.linalg.eigvalsh(projected)
    assert values.min() > -1e-10 * values.max()


@pytest.mark.parametrize(
    ("element", "subdivisions", "scale"), [("P1", 2, 1.0), ("P1", 2, 1.1), ("P2", 1, 1.1)], ids=str
)
def test_a_body_stays_rigid_and_a_sequence_goes_on(spheres, element, subdivisions, scale):
    """Held vertices and the body's are where they belong; a start at the answer needs its edges' nodes alone."""
    scene = jaw_scene(spheres(subdivisions), scale=scale)
    prepared = prepare(scene, solver="skfem", element=element)
    answer = prepared.solve(tolerance=1e-11)
    assert answer.converged and answer.iterations <= 15
    body = scene.of(terms.RigidBody)[0]
    rest = scene.body_rest(body)
    np.testing.assert_allclose(pdist(answer.positions[body.vertices]), pdist(rest), rtol=1e-12)
    assert np.linalg.norm(answer.positions[body.vertices] - rest, axis=1).max() > 5.0
    held, places = scene.dirichlet()
    assert np.array_equal(answer.positions[held], places[held])
    if element == "P1":
        again = prepared.solve(start=answer.positions, tolerance=1e-3)
        np.testing.assert_allclose(again.positions, answer.positions, atol=1e-6)
        return
    again = prepared.solve(start=answer.positions, tolerance=1e-11)
    assert again.converged
    np.testing.assert_allclose(again.positions, answer.positions, atol=1e-8)
    assert answer.energy < solve(scene, solver="skfem").energy


def test_another_size_of_a_body_is_solved_from_the_pose_before(sphere_head):
    prepared = prepare(jaw_scene(sphere_head), solver="skfem")
    answer = prepared.solve(tolerance=1e-11)
    larger = jaw_scene(sphere_head, scale=1.1)
    scaled = prepared.solve(larger, start=answer.positions, tolerance=1e-11)
    np.testing.assert_allclose(scaled.positions, solve(larger, solver="skfem", tolerance=1e-11).positions, atol=1e-7)


def test_body_alone_takes_the_best_rigid_motion():
    """All vertices in one body, springs to scattered places: the least-squares rotation of their covariance."""
    X, tets = meshes.unstructured(2, 2.0)
    goal = Rotation.from_rotvec([1.0, -2.0, 0.5]).apply(X) + [3.0, 1.0, 2.0]
    goal += np.random.default_rng(0).normal(0.0, 0.1, X.shape)
    best, _ = Rotation.align_vectors(goal - goal.mean(axis=0), X - X.mean(axis=0))
    scene = Scene(X, tets, [terms.RigidBody(np.arange(len(X))), terms.Target(np.arange(len(X)), goal, 2.0)])
    answer = solve(scene, solver="skfem", tolerance=1e-11)
    assert answer.converged
    np.testing.assert_allclose(answer.positions, best.apply(X - X.mean(axis=0)) + goal.mean(axis=0), atol=1e-10)


def test_free_body_falls_for_one_step(sphere_head):
    """With inertia alone everything moves on by h v + h² g, a body of it too."""
    V, n, h = np.array(sphere_head.vertices), len(sphere_head.bone), 1 / 60
    g, v = np.array([0.0, -9810.0, 0.0]), np.array([100.0, 30.0, -50.0])
    body = terms.RigidBody(2 * n + np.flatnonzero(sphere_head.bone == MANDIBLE))
    moving = terms.Inertia(1e-6, h, velocities=np.tile(v, (len(V), 1)))
    scene = Scene(V, sphere_head.tets, [terms.Strain(5.0), moving, terms.Gravity(g, 1e-6), body])
    answer = solve(scene, solver="skfem", tolerance=1e-12)
    np.testing.assert_allclose(answer.positions - V, np.tile(h * v + h**2 * g, (len(V), 1)), atol=1e-9)
