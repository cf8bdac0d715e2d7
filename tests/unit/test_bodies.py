"""Rigid bodies by every solver: exactly rigid, where the best motion is, and as a block of ever stiffer tets."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from softdeca.lhm.base.geometry.warp import rigid_motion
from softdeca.lhm.head.head import CRANIUM, MANDIBLE
from softdeca.reference import Reason, Scene, prepare, terms
from softdeca.reference.problems import meshes

from .by_solver import SOLVERS, WAYS, element_options, prepare_by, solve_by

X, TETS = meshes.box((6, 3, 3), (20.0, 8.0, 8.0))
LEFT, RIGHT = (meshes.vertices_at(X, 0, side) for side in (0.0, 20.0))
ELASTIC = [terms.Strain(5.0), terms.Volume(20.0)]
TURN = Rotation.from_rotvec([0.2, -0.5, 0.9])
each_solver = pytest.mark.parametrize("solver", SOLVERS)


def mandible_of(head):
    return 2 * len(head.bone) + np.flatnonzero(head.bone == MANDIBLE)


def jaw_scene(head, *more, scale=1.0):
    """Tissue pulled by a skin whose lower part turns, a held cranium, and a free mandible `scale` times its size."""
    V, n = np.array(head.vertices), len(head.bone)
    turned = Rotation.from_euler("x", 15.0, degrees=True).apply(V[:n])
    share = np.clip((-V[:n, 1] - 20.0) / 40.0, 0.0, 1.0)[:, None]
    mandible = mandible_of(head)
    centre = V[mandible].mean(axis=0)
    body = terms.RigidBody(mandible, centre + scale * (V[mandible] - centre))
    held = terms.Fixed(2 * n + np.flatnonzero(head.bone == CRANIUM))
    tissue = [terms.Strain(5.0), terms.Volume(60.0), terms.SurfaceStrain(head.skin_wrap.triangles, 60.0)]
    target = terms.Target(np.arange(n), V[:n] + share * (turned - V[:n]), 5.0 * head.skin_wrap.vertex_areas)
    return Scene(V, head.tets, [*tissue, target, held, body, *more])


def curved(head, solver):
    """Bending of skin and skull, but for scikit-fem, which has none."""
    n = len(head.bone)
    if solver == "skfem":
        return []
    return [terms.Bending(head.skin_wrap.triangles, 3e3), terms.Bending(2 * n + head.skin_wrap.triangles, 1e4)]


def assert_rigid(positions, body, rest):
    rotation, shift = rigid_motion(rest, positions[body])
    np.testing.assert_allclose(positions[body], rest @ rotation.T + shift, atol=1e-12)
    np.testing.assert_allclose(pdist(positions[body]), pdist(rest), rtol=1e-12)


WAYS_OF_JAWS = [
    ("projective", {}, 2, 1.0),
    ("projective", {}, 2, 1.1),
    *(("fenicsx", {"linear_solver": linear}, 1, scale) for linear in ("cg", "mumps") for scale in (1.0, 1.1)),
    ("fenicsx", {}, 2, 1.1),
    ("fenicsx", {"element": "P2"}, 1, 1.1),
    ("skfem", {}, 2, 1.0),
    ("skfem", {}, 1, 1.1),
    ("skfem", {"element": "P2"}, 1, 1.1),
]


@pytest.mark.parametrize(("solver", "options", "subdivisions", "scale"), WAYS_OF_JAWS, ids=str)
def test_a_body_stays_rigid_and_a_sequence_goes_on(spheres, solver, options, subdivisions, scale):
    """In a few iterations of Newton; a body's other size is taken without preparing anew, from rest or an answer."""
    head = spheres(subdivisions)
    bent = curved(head, solver)
    scene = jaw_scene(head, *bent, scale=scale)
    before = scene if solver == "projective" else jaw_scene(head, *bent)  # whose matrix has the body's shape
    prepared = prepare_by(solver, before, **options)
    answer = prepared.solve(scene, tolerance=1e-11)
    assert answer.converged and (answer.iterations <= 15 or solver == "projective")
    body = scene.of(terms.RigidBody)[0]
    assert_rigid(answer.positions, body.vertices, scene.body_rest(body))
    assert np.linalg.norm(answer.positions[body.vertices] - scene.body_rest(body), axis=1).max() > 5.0
    held, places = scene.dirichlet()
    assert np.array_equal(answer.positions[held], places[held])
    again = prepared.solve(scene, start=answer.positions, tolerance=1e-11 if options.get("element") == "P2" else 1e-3)
    np.testing.assert_allclose(again.positions, answer.positions, atol=1e-6)
    if options.get("element") == "P2":
        assert answer.energy < solve_by(solver, scene, tolerance=1e-9).energy
    elif scale != 1.0:
        first = prepared.solve(tolerance=1e-11)
        for start in (first.positions, answer.positions):
            scaled = prepared.solve(scene, start=start, tolerance=1e-11)
            np.testing.assert_allclose(scaled.positions, solve_by(solver, scene).positions, atol=1e-7)


@pytest.mark.parametrize(("solver", "element"), WAYS)
@pytest.mark.parametrize("angle", [0.3, 2.0, 3.1])
def test_a_body_alone_takes_the_best_rigid_motion(solver, element, angle):
    """All vertices in one body, springs to scattered places: the least-squares rotation of their covariance."""
    goal = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).apply(X) + [3.0, 1.0, 2.0]
    goal += np.random.default_rng(0).normal(size=X.shape)
    best, _ = Rotation.align_vectors(goal - goal.mean(axis=0), X - X.mean(axis=0))
    every = np.arange(len(X))
    scene = Scene(X, TETS, [terms.RigidBody(every), terms.Target(every, goal, 2.0)])
    expected = best.apply(X - X.mean(axis=0)) + goal.mean(axis=0)
    for options in ({"method": "plain"}, {}) if solver == "projective" else (element_options(solver, element),):
        positions = solve_by(solver, scene, **options).positions
        np.testing.assert_allclose(positions, expected, atol=1e-8 if solver == "projective" else 1e-10)
        assert_rigid(positions, every, X)


@each_solver
def test_everything_follows_targets_that_turn(sphere_head, solver):
    """All vertices are pulled to the scene turned by 70° and shifted: that is the minimiser, of energy zero."""
    Q, shift = Rotation.from_rotvec([0.5, -0.9, 0.65]), np.array([30.0, -5.0, 12.0])
    V, n = np.array(sphere_head.vertices), len(sphere_head.bone)
    tissue = [terms.Strain(5.0), terms.Volume(60.0), *curved(sphere_head, solver)]
    pull = terms.Target(np.arange(n), Q.apply(V[:n]) + shift, 100.0)
    scene = Scene(V, sphere_head.tets, [*tissue, pull, terms.RigidBody(mandible_of(sphere_head))])
    np.testing.assert_allclose(solve_by(solver, scene).positions, Q.apply(V) + shift, atol=1e-6)


@each_solver
def test_a_boundary_that_is_a_body_leaves_nothing_to_strain(solver):
    boundary = np.unique(meshes.boundary_triangles(TETS))
    assert len(boundary) < len(X)
    goal = TURN.apply(X[boundary]) + 5.0
    scene = Scene(X, TETS, [*ELASTIC, terms.RigidBody(boundary), terms.Target(boundary, goal, 1.0)])
    np.testing.assert_allclose(solve_by(solver, scene).positions, TURN.apply(X) + 5.0, atol=1e-8)


@each_solver
def test_a_free_body_falls_for_one_step(sphere_head, solver):
    """On springs m/h² to where each vertex goes by itself everything moves on by h v + h² g, a body of it too."""
    V, h = np.array(sphere_head.vertices), 1 / 60
    g, v = np.array([0.0, -9810.0, 0.0]), np.array([100.0, 30.0, -50.0])
    gravity = terms.Gravity(g, 1e-6)
    mass = gravity.lump(Scene(V, sphere_head.tets, [gravity]), 1e-6)
    heavy = np.flatnonzero(mass)
    moving = terms.Target(heavy, V[heavy] + h * v, mass[heavy] / h**2)
    falling = [terms.Strain(5.0), moving, gravity, terms.RigidBody(mandible_of(sphere_head))]
    answer = solve_by(solver, Scene(V, sphere_head.tets, falling), tolerance=1e-12)
    np.testing.assert_allclose(answer.positions - V, np.tile(h * v + h**2 * g, (len(V), 1)), atol=1e-9)


def two_bodies(method="lbfgs", **changes):
    """Both ends are bodies: one pulled to a turned place at its corners, one drawn by gravity along with the bar."""
    goal = TURN.apply(X[RIGHT]) + [1.0, 3.0, -2.0]
    bodies = [terms.RigidBody(LEFT), terms.RigidBody(RIGHT)]
    loads = [terms.Target(RIGHT[:7], goal[:7], 3.0), terms.Gravity((0, -9810, 0), 2e-5)]
    return prepare(replace(Scene(X, TETS, [*ELASTIC, *bodies, *loads]), **changes), method=method)


def test_the_global_step_is_that_of_the_whole_matrix():
    """Against the dense matrix of all unknowns, Tᵀ (A ⊗ 1) T with T by finite differences of `move`; with rollers."""
    roller = terms.Fixed([40], X[[40]], components=1)
    prepared = two_bodies("plain", terms=(*two_bodies().scene.terms, roller))
    coordinates, rng = prepared.system.coordinates, np.random.default_rng(2)
    place = coordinates.start(TURN.apply(X) - X)
    moves = [[coordinates.move(place, h * step).u for h in (1e-5, -1e-5)] for step in np.eye(coordinates.size)]
    tangent = np.stack([(ahead - behind).ravel() / 2e-5 for ahead, behind in moves], axis=1)
    matrix = np.kron(prepared.energy.matrix(prepared.scene)[0].toarray(), np.eye(3))
    right = rng.normal(size=coordinates.size)
    expected = np.linalg.solve(tangent.T @ matrix @ tangent, right)
    np.testing.assert_allclose(prepared.system.solve(right, place.rotations), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("method", "tolerance"), [("lbfgs", 1e-9), ("plain", 1e-3)])
def test_two_bodies_stay_rigid_and_the_energy_falls(method, tolerance):
    prepared = two_bodies(method)
    solution = prepared.solve(tolerance=tolerance)
    energies = solution.history.energy
    assert solution.converged
    assert (np.diff(energies) <= 1e-12 * np.abs(energies[1:])).all()
    for body in (LEFT, RIGHT):
        assert_rigid(solution.positions, body, X[body])
    if method == "plain":
        return
    _, gradient = prepared.energy.evaluate(solution.positions - X)
    arms = solution.positions[LEFT] - solution.positions[LEFT].mean(axis=0)
    scale = np.abs(gradient).max()
    np.testing.assert_allclose(gradient[LEFT].sum(axis=0), 0.0, atol=1e-6 * scale)
    np.testing.assert_allclose(np.cross(arms, gradient[LEFT]).sum(axis=0), 0.0, atol=1e-5 * scale)


def test_a_body_is_the_limit_of_stiff_tets():
    """A block of tets 1e2, 1e3, 1e4 times as stiff in strain differs from the body by 1/stiffness."""
    middle = np.flatnonzero((X[TETS][:, :, 0] > 6.0).all(axis=1) & (X[TETS][:, :, 0] < 14.0).all(axis=1))
    block = np.unique(TETS[middle])
    twisted = Rotation.from_rotvec([0.5, 0.0, 0.0]).apply(X[RIGHT]) + [2.0, 0.0, 0.0]
    held = terms.Fixed(np.r_[LEFT, RIGHT], np.r_[X[LEFT], twisted])
    others = [*ELASTIC, held, terms.Gravity((0, -9810, 0), 2e-6)]
    rigid = solve_by("projective", Scene(X, TETS, [*others, terms.RigidBody(block)]), tolerance=1e-10).positions
    assert np.abs(rigid[block] - X[block]).max() > 1.0
    away = []
    for stiffness in (1e2, 1e3, 1e4):
        stiff = Scene(X, TETS, [*others, terms.Strain(5.0 * stiffness, tets=middle)])
        away.append(np.abs(solve_by("projective", stiff, start=rigid, tolerance=1e-6).positions - rigid).max())
    assert away[2] < 1e-3
    np.testing.assert_allclose(np.log10(away[:-1]) - np.log10(away[1:]), 1.0, atol=0.1)


def test_a_scaled_body_keeps_its_own_shape_and_one_that_only_tets_hold_is_held():
    """It is linked to what is fixed by tets, so gravity may pull it; a bar with free ends may not be pulled."""
    scaled, gravity = X[RIGHT] * [1.0, 1.2, 0.9] + [2.0, 0.0, 0.0], terms.Gravity((0, -9810, 0), 1e-6)
    shaped = Scene(X, TETS, [*ELASTIC, terms.Fixed(LEFT), terms.RigidBody(RIGHT, scaled), gravity])
    assert_rigid(solve_by("projective", shaped, tolerance=1e-9).positions, RIGHT, scaled)


def test_the_start_is_brought_to_the_nearest_rigid_place():
    start = X + np.random.default_rng(3).normal(scale=0.1, size=X.shape)
    solution = two_bodies().solve(start=start, max_iterations=0)
    assert solution.reason is Reason.MAX_ITERATIONS
    rotation, shift = rigid_motion(X[LEFT], start[LEFT])
    np.testing.assert_allclose(solution.positions[LEFT], X[LEFT] @ rotation.T + shift, atol=1e-12)
    inner = np.setdiff1d(np.arange(len(X)), np.r_[LEFT, RIGHT])
    np.testing.assert_allclose(solution.positions[inner], start[inner], atol=1e-14)
