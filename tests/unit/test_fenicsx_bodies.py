"""Rigid bodies, bending and inertia on FEniCSx: derivatives by finite differences, rigidity, closed forms."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

pytest.importorskip("dolfinx")

from softdeca.lhm.head import CRANIUM, MANDIBLE
from softdeca.reference import Scene, SceneError, solve, terms
from softdeca.reference.fenicsx import prepare
from softdeca.reference.fenicsx.bending import Rings
from softdeca.reference.fenicsx.bodies import RigidProblem
from softdeca.reference.fenicsx.numbering import Numbering
from softdeca.reference.fenicsx.problem import Problem
from softdeca.reference.problems import meshes


def jaw_scene(head, *more, jaw=15.0, scale=1.0, bone=True):
    """Tissue pulled by a skin whose lower part turns, a held cranium, and a free mandible `scale` times its size."""
    V, n = np.array(head.vertices), len(head.bone)
    turned = Rotation.from_euler("x", jaw, degrees=True).apply(V[:n])
    share = np.clip((-V[:n, 1] - 20.0) / 40.0, 0.0, 1.0)[:, None]
    mandible = 2 * n + np.flatnonzero(head.bone == MANDIBLE)
    centre = V[mandible].mean(axis=0)
    body = terms.RigidBody(mandible, centre + scale * (V[mandible] - centre))
    held = terms.Fixed(2 * n + np.flatnonzero(head.bone == CRANIUM))
    tissue = [terms.Strain(5.0), terms.Volume(60.0), terms.SurfaceStrain(head.skin_wrap.triangles, 60.0)]
    target = terms.Target(np.arange(n), V[:n] + share * (turned - V[:n]), 5.0 * head.skin_wrap.vertex_areas)
    return Scene(V, head.tets, [*tissue, target, *([held, body] if bone else []), *more])


def bent(head):
    n = len(head.bone)
    return [terms.Bending(head.skin_wrap.triangles, 3e3), terms.Bending(2 * n + head.skin_wrap.triangles, 1e4)]


def dense(matrix):
    indptr, indices, values = matrix.getValuesCSR()
    return csr_matrix((values, indices, indptr), matrix.size).toarray()


@pytest.fixture(scope="module")
def rigid(sphere_head):
    """A problem with a body, at a state of large random turns and small random displacements."""
    scene = jaw_scene(sphere_head, *bent(sphere_head))
    order = Numbering(scene)
    problem = RigidProblem(scene, order, Problem(scene, order))
    rng = np.random.default_rng(3)
    step = rng.normal(0.0, 1.0, (problem.count, 3))
    step[-1] *= 20.0
    return problem, problem.moved(problem.at(np.zeros_like(order.X), problem.rest()), step.ravel())


def test_gradient_over_the_unknowns(rigid):
    problem, state = rigid
    gradient = state.gradient().ravel()
    for seed in range(3):
        d = np.random.default_rng(seed).normal(size=gradient.size)
        d[:-6] *= seed  # the body alone, too
        ahead, behind = (problem.moved(state, h * d).energy for h in (1e-4, -1e-4))
        assert (ahead - behind) / 2e-4 == pytest.approx(gradient @ d, rel=1e-6)


def test_hessian_over_the_unknowns(rigid):
    """exp([(s + h) ω]) = exp([h ω]) exp([s ω]): along a line, gradient · d is the energy's slope, not only at 0."""
    problem, state = rigid
    H = dense(state.hessian())
    np.testing.assert_allclose(H, H.T, atol=1e-10 * np.abs(H).max())
    for seed in range(3):
        d = np.random.default_rng(seed).normal(size=len(H))
        d[:-6] *= seed
        ahead, behind = (problem.moved(state, h * d).gradient().ravel() @ d for h in (1e-4, -1e-4))
        assert (ahead - behind) / 2e-4 == pytest.approx(d @ H @ d, rel=1e-6)


def test_matrix_is_assembled_anew_at_every_state(rigid):
    problem, state = rigid
    before = dense(state.hessian())
    other = problem.moved(state, np.full(before.shape[0], 2.0))
    assert np.abs(dense(other.hessian()) - before).max() > 1e-3 * np.abs(before).max()
    np.testing.assert_allclose(dense(state.hessian()), before, rtol=0.0, atol=1e-12 * np.abs(before).max())


def test_projected_hessian_is_semidefinite(rigid):
    _, state = rigid
    assert np.linalg.eigvalsh(dense(state.hessian())).min() < 0.0
    eigenvalues = np.linalg.eigvalsh(dense(state.softened_hessian(0.0)))
    assert eigenvalues.min() > -1e-10 * eigenvalues.max()


@pytest.mark.parametrize("linear", ["cg", "mumps"])
@pytest.mark.parametrize("scale", [1.0, 1.1])
def test_body_stays_rigid_and_newton_converges(sphere_head, linear, scale):
    scene = jaw_scene(sphere_head, *bent(sphere_head), scale=scale)
    answer = solve(scene, solver="fenicsx", tolerance=1e-11, linear_solver=linear)
    assert answer.converged and answer.iterations <= 15
    body = scene.of(terms.RigidBody)[0]
    rest = scene.body_rest(body)
    np.testing.assert_allclose(pdist(answer.positions[body.vertices]), pdist(rest), rtol=1e-12)
    assert np.linalg.norm(answer.positions[body.vertices] - rest, axis=1).max() > 5.0


def test_everything_follows_targets_that_turn(sphere_head):
    """All vertices are pulled to the scene turned by 70° and shifted: that is the minimiser, of energy zero."""
    Q, shift = Rotation.from_rotvec([0.5, -0.9, 0.65]), np.array([30.0, -5.0, 12.0])
    V, n = np.array(sphere_head.vertices), len(sphere_head.bone)
    body = terms.RigidBody(2 * n + np.flatnonzero(sphere_head.bone == MANDIBLE))
    tissue = [terms.Strain(5.0), terms.Volume(60.0), *bent(sphere_head)]
    scene = Scene(V, sphere_head.tets, [*tissue, terms.Target(np.arange(n), Q.apply(V[:n]) + shift, 100.0), body])
    answer = solve(scene, solver="fenicsx", tolerance=1e-12)
    np.testing.assert_allclose(answer.positions, Q.apply(V) + shift, atol=1e-8)


def test_prepared_bodies_take_another_shape_and_start(sphere_head):
    larger = jaw_scene(sphere_head, scale=1.1)
    direct = solve(larger, solver="fenicsx", tolerance=1e-11)
    prepared = prepare(jaw_scene(sphere_head))
    first = prepared.solve(tolerance=1e-11)
    for start in (None, first.positions):
        again = prepared.solve(larger, start=start, tolerance=1e-11)
        assert again.converged
        np.testing.assert_allclose(again.positions, direct.positions, atol=1e-7)


def test_body_of_quadratic_elements_is_rigid_and_softer_around(sphere_head):
    scene = jaw_scene(sphere_head)
    answer = solve(scene, solver="fenicsx", element="P2", tolerance=1e-9)
    assert answer.converged
    body = scene.of(terms.RigidBody)[0]
    np.testing.assert_allclose(pdist(answer.positions[body.vertices]), pdist(scene.body_rest(body)), rtol=1e-12)
    assert answer.energy < solve(scene, solver="fenicsx", tolerance=1e-9).energy


def test_body_alone_takes_the_best_rigid_motion():
    """All vertices in one body, springs to scattered places: the least-squares rotation of their covariance."""
    X, tets = meshes.unstructured(2, 2.0)
    goal = Rotation.from_rotvec([1.0, -2.0, 0.5]).apply(X) + [3.0, 1.0, 2.0]
    goal += np.random.default_rng(0).normal(0.0, 0.1, X.shape)
    best, _ = Rotation.align_vectors(goal - goal.mean(axis=0), X - X.mean(axis=0))
    scene = Scene(X, tets, [terms.RigidBody(np.arange(len(X))), terms.Target(np.arange(len(X)), goal, 2.0)])
    answer = solve(scene, solver="fenicsx", tolerance=1e-11)
    assert answer.converged
    np.testing.assert_allclose(answer.positions, best.apply(X - X.mean(axis=0)) + goal.mean(axis=0), atol=1e-10)


def test_free_body_falls_for_one_step(sphere_head):
    """With inertia alone everything moves on by h v + h² g, a body of it too."""
    V, n, h = np.array(sphere_head.vertices), len(sphere_head.bone), 1 / 60
    g, v = np.array([0.0, -9810.0, 0.0]), np.array([100.0, 30.0, -50.0])
    body = terms.RigidBody(2 * n + np.flatnonzero(sphere_head.bone == MANDIBLE))
    moving = terms.Inertia(1e-6, h, velocities=np.tile(v, (len(V), 1)))
    scene = Scene(V, sphere_head.tets, [terms.Strain(5.0), moving, terms.Gravity(g, 1e-6), body])
    answer = solve(scene, solver="fenicsx", tolerance=1e-12)
    np.testing.assert_allclose(answer.positions - V, np.tile(h * v + h**2 * g, (len(V), 1)), atol=1e-9)


def test_inertia_takes_the_next_step(sphere_head):
    scene = jaw_scene(sphere_head, terms.Inertia(1e-6, 1 / 60))
    prepared = prepare(scene)
    one = prepared.solve(tolerance=1e-11).positions
    after = jaw_scene(sphere_head, terms.Inertia(1e-6, 1 / 60, one, 60.0 * (one - scene.vertices)))
    two = prepared.solve(after, start=one, tolerance=1e-11)
    assert two.converged
    np.testing.assert_allclose(two.positions, solve(after, solver="fenicsx", tolerance=1e-11).positions, atol=1e-7)
    still = solve(jaw_scene(sphere_head), solver="fenicsx", tolerance=1e-11).positions
    away = [np.linalg.norm(x - still) for x in (scene.vertices, one)]
    assert away[1] < 0.9 * away[0]


def rings_of_a_bump():
    rng = np.random.default_rng(0)
    X, Y = np.meshgrid(np.arange(5.0), np.arange(6.0), indexing="ij")
    points = np.stack([X, Y, 0.3 * np.sin(X + Y)], axis=2).reshape(-1, 3) + rng.normal(0.0, 0.1, (30, 3))
    corner = (6 * np.arange(4)[:, None] + np.arange(5)).ravel()
    lower = np.column_stack([corner, corner + 6, corner + 7])
    triangles = np.concatenate([lower, np.column_stack([corner, corner + 7, corner + 1])])
    term = terms.Bending(triangles, rng.uniform(1.0, 2.0, len(triangles)))
    return points, term, points + rng.normal(0.0, 0.3, points.shape)


def total_gradient(rings, x):
    into = np.zeros_like(x)
    for ring in rings:
        ring.add_gradient(x, into)
    return into


def test_bending_derivatives():
    X, term, x = rings_of_a_bump()
    rings = Rings.from_term(term, X, np.arange(len(X)), len(X))
    assert sum(len(ring.nodes) for ring in rings) == 3 * 4
    d, h = np.random.default_rng(1).normal(size=x.shape), 1e-5
    ahead, behind = (sum(ring.energy(x + s * d) for ring in rings) for s in (h, -h))
    assert (ahead - behind) / (2 * h) == pytest.approx(np.sum(total_gradient(rings, x) * d), rel=1e-7)
    expected = (total_gradient(rings, x + h * d) - total_gradient(rings, x - h * d)) / (2 * h)
    product = np.zeros_like(x)
    for ring in rings:
        np.add.at(product, ring.nodes, np.einsum("eijab,ejb->eia", ring.hessian(x, 1.0), d[ring.nodes]))
        k = 3 * ring.nodes.shape[1]
        projected = ring.hessian(x, 0.0).transpose(0, 1, 3, 2, 4).reshape(-1, k, k)
        assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(projected).max()
    np.testing.assert_allclose(product, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())


def test_bending_knows_turns_and_dents():
    """Nothing for a rigid motion; a bump turned into a dent has twice the curvature of the bump to undo."""
    X, term, x = rings_of_a_bump()
    rings = Rings.from_term(term, X, np.arange(len(X)), len(X))
    turned = Rotation.from_rotvec([2.0, -1.0, 0.3]).apply(X) + 4.0
    assert sum(ring.energy(turned) for ring in rings) < 1e-20
    flat, bump = np.array(X), np.array(X)
    flat[:, 2] = 0.0
    flattened = terms.Bending(term.triangles, 1.0, rest=flat)
    bump[:, 2] = 1e-4 * np.cos(X[:, 0])
    dent = bump * [1.0, 1.0, -1.0]
    from_flat = sum(ring.energy(bump) for ring in Rings.from_term(flattened, X, np.arange(len(X)), len(X)))
    bent_over = terms.Bending(term.triangles, 1.0, rest=bump)
    from_bump = sum(ring.energy(dent) for ring in Rings.from_term(bent_over, X, np.arange(len(X)), len(X)))
    assert from_bump == pytest.approx(4.0 * from_flat, rel=1e-3)


def test_body_on_a_vertex_in_no_tet_is_refused(sphere_head):
    scene = jaw_scene(sphere_head, bone=False)
    V = np.concatenate([scene.vertices, [[0.0, 0.0, 0.0]]])
    body = terms.RigidBody(np.array([0, 1, len(V) - 1]))
    with pytest.raises(SceneError, match=f"RigidBody: vertex {len(V) - 1} is in no tet"):
        prepare(Scene(V, scene.tets, [*scene.terms, body]))
