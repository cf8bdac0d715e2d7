"""Rigid bodies and bending on scikit-fem: derivatives by finite differences, rigidity, closed forms."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from softdeca.lhm.head import CRANIUM, MANDIBLE
from softdeca.reference import Scene, solve, terms
from softdeca.reference.problems import meshes
from softdeca.reference.skfem import prepare
from softdeca.reference.skfem.discretisation import Discretisation
from softdeca.reference.skfem.energy import Energy
from softdeca.reference.skfem.solids import project_spd
from softdeca.reference.skfem.surfaces import Bends
from softdeca.reference.skfem.unknowns import Body, Unknowns


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
    bodies = Body.all_of(scene, at)
    free = ~at.held(scene.dirichlet()[0])
    free[bodies[0].dofs] = False
    unknowns = Unknowns(np.flatnonzero(free), at.size, bodies)
    step = np.random.default_rng(3).normal(0.0, 1.0, unknowns.count)
    step[-3:] *= 20.0
    return Energy(scene, at), unknowns, unknowns.moved(at.flat(scene.vertices), step)


def reduced_gradient(energy, unknowns, x):
    return unknowns.gradient(x, energy.gradient(x))


def test_gradient_over_the_unknowns(turned):
    energy, unknowns, x = turned
    gradient = reduced_gradient(energy, unknowns, x)
    for seed in range(3):
        d = np.random.default_rng(seed).normal(size=unknowns.count)
        d[:-6] *= seed
        ahead, behind = (energy.value(unknowns.moved(x, h * d)) for h in (1e-4, -1e-4))
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
        moved = [unknowns.moved(x, h * d) for h in (1e-4, -1e-4)]
        ahead, behind = (reduced_gradient(energy, unknowns, y) @ d for y in moved)
        assert (ahead - behind) / 2e-4 == pytest.approx(d @ H @ d, rel=1e-6)


def test_projected_hessian_is_semidefinite(turned):
    energy, unknowns, x = turned
    projected = unknowns.projected_hessian(x, energy.gradient(x), energy.projected_hessian(x)).toarray()
    values = np.linalg.eigvalsh(projected)
    assert values.min() > -1e-10 * values.max()


@pytest.mark.parametrize("scale", [1.0, 1.1])
def test_body_stays_rigid_and_newton_converges(sphere_head, scale):
    scene = jaw_scene(sphere_head, scale=scale)
    answer = solve(scene, solver="skfem", tolerance=1e-11)
    assert answer.converged and answer.iterations <= 15
    body = scene.of(terms.RigidBody)[0]
    rest = scene.body_rest(body)
    np.testing.assert_allclose(pdist(answer.positions[body.vertices]), pdist(rest), rtol=1e-12)
    assert np.linalg.norm(answer.positions[body.vertices] - rest, axis=1).max() > 5.0


def test_start_gives_the_pose(sphere_head):
    prepared = prepare(jaw_scene(sphere_head))
    answer = prepared.solve(tolerance=1e-11)
    again = prepared.solve(start=answer.positions, tolerance=1e-3)
    np.testing.assert_allclose(again.positions, answer.positions, atol=1e-6)
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


def bent_side():
    """A block with Bending on one of its sides, positions far from rest, and the term's part of the energy."""
    rng = np.random.default_rng(0)
    X, tets = meshes.unstructured(4, 4.0)
    triangles = meshes.triangles_at(X, tets, 2, 4.0)
    X = X + rng.normal(0.0, 0.05, X.shape)
    term = terms.Bending(triangles, rng.uniform(1.0, 2.0, len(triangles)))
    scene = Scene(X, tets, [term])
    at = Discretisation(scene)
    return Bends(scene, term, at), at, X, at.flat(X + rng.normal(0.0, 0.2, X.shape))


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
    assert part.value(at.flat(turn.apply(X) + 4.0)) < 1e-20 < part.value(x)
    assert part.value(at.flat(turn.apply(x[at.dofs]) + 4.0)) == pytest.approx(part.value(x), rel=1e-10)


def test_surface_seeks_another_rest_shape():
    """F is measured from `rest`, the area from the scene: a block's side 1.2 times as large in rest, all held."""
    X, tets = meshes.unstructured(3, 2.0)
    triangles = meshes.triangles_at(X, tets, 2, 2.0)
    term = terms.SurfaceStrain(triangles, 3.0, 1.1, rest=1.2 * X)
    answer = solve(Scene(X, tets, [term, terms.Fixed(np.arange(len(X)))]), solver="skfem", max_iterations=0)
    assert answer.energy == pytest.approx(0.5 * 3.0 * 4.0 * 2.0 * (1 / 1.2 - np.sqrt(1.1)) ** 2, rel=1e-12)
