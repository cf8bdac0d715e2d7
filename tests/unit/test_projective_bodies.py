"""Rigid bodies in projective dynamics: exactly rigid, in balance, and as a block of ever stiffer tets would be."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skfem import MeshTet

from softdeca.lhm.base.errors import SceneError
from softdeca.lhm.base.geometry.warp import rigid_motion
from softdeca.lhm.base.mesh import tet_volumes
from softdeca.reference import Reason, Scene, prepare, solve, terms


def bar(cells=(6, 3, 3), lengths=(20.0, 8.0, 8.0)):
    lines = [np.linspace(0, length, n + 1) for n, length in zip(cells, lengths, strict=True)]
    mesh = MeshTet.init_tensor(*lines)
    X, tets = mesh.p.T.copy(), mesh.t.T.copy()
    turned = tet_volumes(X, tets) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    return X, tets


X, TETS = bar()
LEFT, RIGHT = (np.flatnonzero(np.isclose(X[:, 0], side)) for side in (0.0, 20.0))
ELASTIC = [terms.Strain(5.0), terms.Volume(20.0)]
TURN = Rotation.from_rotvec([0.2, -0.5, 0.9])


def assert_rigid(positions, body, rest):
    rotation, shift = rigid_motion(rest, positions[body])
    np.testing.assert_allclose(positions[body], rest @ rotation.T + shift, atol=1e-12)


def two_bodies(method="lbfgs", **changes):
    """Both ends are bodies: one pulled to a turned place at its corners, one drawn by gravity along with the bar."""
    goal = TURN.apply(X[RIGHT]) + [1.0, 3.0, -2.0]
    scene = Scene(
        X,
        TETS,
        [
            *ELASTIC,
            terms.RigidBody(LEFT),
            terms.RigidBody(RIGHT),
            terms.Target(RIGHT[:7], goal[:7], 3.0),
            terms.Gravity((0, -9810, 0), 2e-5),
        ],
    )
    return prepare(replace(scene, **changes), method=method)


@pytest.mark.parametrize("angle", [0.3, 2.0, 3.1])
def test_a_body_alone_follows_its_targets_by_procrustes(angle):
    """All vertices of the bar, without elasticity, pulled to places that no rigid motion reaches."""
    turned = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).apply(X)
    goal = turned + np.random.default_rng(0).normal(size=X.shape)
    every = np.arange(len(X))
    scene = Scene(X, TETS, [terms.RigidBody(every), terms.Target(every, goal, 2.0)])
    rotation, shift = rigid_motion(X, goal)
    for method in ("lbfgs", "plain"):
        solution = solve(scene, tolerance=1e-11, method=method)
        assert solution.converged, method
        np.testing.assert_allclose(solution.positions, X @ rotation.T + shift, atol=1e-8)
        assert_rigid(solution.positions, every, X)


def test_a_boundary_that_is_a_body_leaves_nothing_to_strain():
    boundary = np.flatnonzero(((X == 0) | (X == [20.0, 8.0, 8.0])).any(axis=1))
    assert len(boundary) < len(X)
    goal = TURN.apply(X[boundary]) + 5.0
    scene = Scene(X, TETS, [*ELASTIC, terms.RigidBody(boundary), terms.Target(boundary, goal, 1.0)])
    solution = solve(scene, tolerance=1e-11)
    assert solution.converged
    np.testing.assert_allclose(solution.positions, TURN.apply(X) + 5.0, atol=1e-8)


def test_gradient_of_a_step_by_finite_differences():
    prepared = two_bodies()
    coordinates, rng = prepared.system.coordinates, np.random.default_rng(1)
    place = coordinates.move(coordinates.start(np.zeros_like(X)), 0.5 * rng.normal(size=coordinates.size))
    pulled = coordinates.pull(prepared.energy.evaluate(place.u)[1], place)
    assert len(pulled) == 3 * (len(X) - len(LEFT) - len(RIGHT)) + 12
    steps = [*np.eye(coordinates.size)[-12:], *rng.normal(size=(5, coordinates.size))]
    for step in steps:
        sides = [prepared.energy.evaluate(coordinates.move(place, h * step).u)[0] for h in (1e-4, -1e-4)]
        assert (sides[0] - sides[1]) / 2e-4 == pytest.approx(pulled @ step, rel=1e-6, abs=1e-5)


def test_the_global_step_is_that_of_the_whole_matrix():
    """Against the dense matrix of all unknowns, Tᵀ (A ⊗ 1) T with T by finite differences of `move`; with rollers."""
    roller = terms.Fixed([40], X[[40]], components=1)
    prepared = two_bodies("plain", terms=(*two_bodies().scene.terms, roller))
    coordinates, rng = prepared.system.coordinates, np.random.default_rng(2)
    place = coordinates.start(TURN.apply(X) - X)
    tangent = np.stack(
        [
            (coordinates.move(place, 1e-5 * step).u - coordinates.move(place, -1e-5 * step).u).ravel() / 2e-5
            for step in np.eye(coordinates.size)
        ],
        axis=1,
    )
    matrix = np.kron(prepared.energy.matrix(prepared.scene)[0].toarray(), np.eye(3))
    right = rng.normal(size=coordinates.size)
    expected = np.linalg.solve(tangent.T @ matrix @ tangent, right)
    np.testing.assert_allclose(prepared.system.solve(right, place.rotations), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("method", ["lbfgs", "plain"])
def test_two_bodies_stay_rigid_and_the_energy_falls(method):
    energies = []
    prepared = two_bodies(method)
    tolerance = {"lbfgs": 1e-9, "plain": 1e-3}[method]
    solution = prepared.solve(tolerance=tolerance, on_iteration=lambda i, x, energy, norm: energies.append(energy))
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
    rigid = solve(Scene(X, TETS, [*others, terms.RigidBody(block)]), tolerance=1e-10).positions
    assert np.abs(rigid[block] - X[block]).max() > 1.0
    away = []
    for stiffness in (1e2, 1e3, 1e4):
        stiff = terms.Strain(5.0 * stiffness, tets=middle)
        solution = solve(Scene(X, TETS, [*others, stiff]), start=rigid, tolerance=1e-6)
        assert solution.converged
        away.append(np.abs(solution.positions - rigid).max())
    assert away[2] < 1e-3
    np.testing.assert_allclose(np.log10(away[:-1]) - np.log10(away[1:]), 1.0, atol=0.1)


def test_a_scaled_body_keeps_its_own_shape():
    scaled = X[RIGHT] * [1.0, 1.2, 0.9] + [2.0, 0.0, 0.0]
    solution = solve(Scene(X, TETS, [*ELASTIC, terms.Fixed(LEFT), terms.RigidBody(RIGHT, scaled)]), tolerance=1e-9)
    assert solution.converged
    assert_rigid(solution.positions, RIGHT, scaled)


def test_a_body_that_only_tets_hold_is_held():
    """It is linked to what is fixed by tets, so gravity may pull it; a bar with free ends may not be pulled."""
    gravity = terms.Gravity((0, -9810, 0), 1e-6)
    assert solve(Scene(X, TETS, [*ELASTIC, terms.Fixed(LEFT), terms.RigidBody(RIGHT), gravity])).converged
    with pytest.raises(SceneError, match="nothing holds the part around vertex 0 along y"):
        solve(Scene(X, TETS, [*ELASTIC, terms.RigidBody(RIGHT), gravity]))


def test_the_start_is_brought_to_the_nearest_rigid_place():
    start = X + np.random.default_rng(3).normal(scale=0.1, size=X.shape)
    solution = two_bodies().solve(start=start, max_iterations=0)
    assert solution.reason is Reason.MAX_ITERATIONS
    rotation, shift = rigid_motion(X[LEFT], start[LEFT])
    np.testing.assert_allclose(solution.positions[LEFT], X[LEFT] @ rotation.T + shift, atol=1e-12)
    inner = np.setdiff1d(np.arange(len(X)), np.r_[LEFT, RIGHT])
    np.testing.assert_allclose(solution.positions[inner], start[inner], atol=1e-14)
