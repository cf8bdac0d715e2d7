"""The exact Hessian against differences of the gradient, term by term, and what is factored of it."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm.base.errors import SceneError
from softdeca.lhm.base.geometry import cholesky
from softdeca.reference import Parameters, Scene, facial_scene, prepare, terms
from softdeca.reference.projective.sparsity import Sparsity
from softdeca.reference.projective.tangent import EXACT, hessian
from softdeca.surrogate.sphere import Spheres

SPACE = Spheres(1)
HEAD = SPACE.fit(SPACE.skin(np.zeros(4)))
X, TETS, TRIANGLES, N = HEAD.vertices, HEAD.tets, HEAD.skin_wrap.triangles, len(HEAD.bone)
PULL = terms.Target(np.arange(50), X[:50] + 1.0, 2.0)
JAW = 2 * N + np.flatnonzero(HEAD.bone == 2)
FACE = facial_scene(HEAD, Parameters(skin_bending=20.0, gravity=2.0), HEAD.skin.vertices)
CASES = {
    "Strain": ([terms.Strain(5.0)], 3.0),
    "Strain with a limit": ([terms.Strain(5.0, 1.1)], 3.0),
    "Strain with growth": ([terms.Strain(5.0, 1.05, growth=1.3)], 3.0),
    "Strain by the indicator": ([terms.Strain(5.0, 1.3, rule="indicator")], 3.0),
    "Volume": ([terms.Volume(50.0, 1.2)], 3.0),
    "Volume, tangled": ([terms.Volume(50.0, 1.2)], 20.0),
    "Strain and Volume": ([terms.Strain(5.0), terms.Volume(50.0), terms.Strain(2.0, tets=np.arange(9))], 3.0),
    "SurfaceStrain": ([terms.SurfaceStrain(TRIANGLES, 20.0, 1.3)], 3.0),
    "Bending": ([terms.Bending(TRIANGLES, 50.0)], 3.0),
    "Target": ([PULL], 3.0),
    "Inertia": ([terms.Inertia(1e-6, 0.01)], 3.0),
    "two bodies": ([terms.Strain(5.0), PULL, terms.RigidBody(JAW), terms.RigidBody(np.arange(60, 70))], 5.0),
    "held": ([terms.Strain(5.0), PULL, terms.Fixed([3, 4], components=1), terms.Fixed([7, 8])], 3.0),
    "a face": (FACE.terms, 2.0),
}


def moved(parts, size):
    """A scene prepared, and a place of it far from rest."""
    prepared = prepare(Scene(X, TETS, parts))
    coordinates = prepared.system.coordinates
    rng = np.random.default_rng(0)
    return prepared, coordinates.move(coordinates.start(np.zeros_like(X)), size * rng.normal(size=coordinates.size))


def of(prepared, place, least=EXACT):
    coordinates = prepared.system.coordinates
    sparsity = Sparsity.from_scene(prepared.scene, prepared.energy, coordinates)
    return hessian(prepared.scene, prepared.energy, coordinates, sparsity, place, least=least).toarray()


@pytest.mark.parametrize("name", CASES)
def test_the_hessian_is_the_gradients_derivative(name):
    """Of the free components' gradient along all steps, and of the energy along a body's own."""
    prepared, place = moved(*CASES[name])
    coordinates, free = prepared.system.coordinates, len(prepared.system.coordinates.index)
    matrix = of(prepared, place)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-14 * abs(matrix).max())
    rng = np.random.default_rng(1)
    steps = np.vstack([rng.normal(size=(6, coordinates.size)), np.eye(coordinates.size)[free:]])
    for step in steps:
        ahead, back = (coordinates.move(place, h * step) for h in (1e-4, -1e-4))
        gradients = [coordinates.pull(prepared.energy.evaluate(at.u)[1], at) for at in (ahead, back)]
        difference = (gradients[0] - gradients[1]) / 2e-4
        np.testing.assert_allclose((matrix @ step)[:free], difference[:free], atol=1e-6 * abs(difference).max())
        if coordinates.bodies:
            along = [g @ step for g in gradients]  # the pull's frame turns along: symmetric about the middle
            assert step @ matrix @ step == pytest.approx((along[0] - along[1]) / 2e-4, rel=1e-5)


@pytest.mark.parametrize("name", CASES)
def test_raised_eigenvalues_are_not_negative_and_leave_sound_elements_alone(name):
    prepared, place = moved(*CASES[name])
    lowest = np.linalg.eigvalsh(of(prepared, place, least=0.0))
    assert lowest[0] > -1e-12 * lowest[-1]
    calm = prepared.system.coordinates.start(np.zeros_like(X))
    if name in ("Strain", "SurfaceStrain"):
        stretched = replace(calm, u=0.3 * X)  # where all is in tension the Hessian has no negative eigenvalue
        np.testing.assert_allclose(of(prepared, stretched, 0.0), of(prepared, stretched), rtol=1e-9, atol=1e-9)
    if name in ("Strain and Volume", "Volume, tangled"):
        assert np.linalg.eigvalsh(of(prepared, place))[0] < -1e-3 * lowest[-1], "nothing to raise: a tame case"


def test_a_tangent_is_factored_and_reused_like_another():
    prepared = prepare(FACE)
    answer = prepared.solve(tolerance=1e-10)
    tangent = prepared.tangent(answer)
    assert tangent.is_exact
    matrix = of(prepared, tangent.place)
    right = np.random.default_rng(0).normal(size=(len(matrix), 3))
    np.testing.assert_allclose(matrix @ tangent.solve(right), right, atol=1e-8)
    np.testing.assert_array_equal(tangent.solve(right[:, 0]).shape, (len(matrix),))
    softer = prepare(facial_scene(HEAD, Parameters(soft_stiffness=2.0, skin_bending=5.0), HEAD.skin.vertices + 1.0))
    second = softer.tangent(softer.solve(tolerance=1e-10), like=tangent)
    assert second.sparsity is tangent.sparsity
    if cholesky.has_cholmod():
        assert second.factor.analysis is tangent.factor.analysis
    np.testing.assert_allclose(of(softer, second.place) @ second.solve(right), right, atol=1e-8)


@pytest.mark.parametrize("linear_solver", ["cholespy", "superlu", "cholmod"])
def test_indefinite_tangents_are_raised_and_say_so(linear_solver, capfd):
    if linear_solver == "cholmod" and not cholesky.has_cholmod():
        pytest.skip("scikit-sparse is not installed")
    prepared = prepare(FACE)
    squeezed = prepared.solve(start=0.7 * X, max_iterations=0, untangle=False)
    tangent = prepared.tangent(squeezed, linear_solver=linear_solver)
    assert not tangent.is_exact
    right = np.random.default_rng(0).normal(size=tangent.coordinates.size)
    np.testing.assert_allclose(of(prepared, tangent.place, 0.0) @ tangent.solve(right), right, atol=1e-5)
    assert prepared.tangent(prepared.solve(tolerance=1e-9), linear_solver=linear_solver).is_exact


def test_without_cholmod_tangents_are_the_same(monkeypatch):
    prepared = prepare(FACE)
    answer = prepared.solve(tolerance=1e-9)
    right = np.random.default_rng(0).normal(size=prepared.system.coordinates.size)
    steps = [prepared.tangent(answer).solve(right)]
    monkeypatch.setattr(cholesky, "has_cholmod", lambda: False)
    steps.append(prepared.tangent(answer).solve(right))
    monkeypatch.setattr(cholesky, "CholeskySolverD", None)
    steps.append(prepared.tangent(answer).solve(right))
    for step in steps[1:]:
        np.testing.assert_allclose(step, steps[0], rtol=1e-8, atol=1e-10)


def test_as_a_metric_it_finds_the_same_minimum_sooner_and_the_same_bits_twice():
    prepared = prepare(FACE)
    deltas = SPACE.expression_deltas(np.zeros(4))
    scene = facial_scene(HEAD, Parameters(skin_bending=20.0, gravity=2.0), HEAD.skin.vertices + deltas[3] + deltas[9])
    neutral = prepared.solve(tolerance=1e-10)
    metric = prepared.tangent(neutral)
    plain, *twice = (
        prepared.solve(scene, start=neutral.positions, absolute=1e-6, metric=m) for m in (None, metric, metric)
    )
    assert plain.history.gradient_norm[-1] <= 1e-6 and twice[0].history.gradient_norm[-1] <= 1e-6
    assert twice[0].converged and 2 * twice[0].iterations < plain.iterations
    np.testing.assert_allclose(twice[0].positions, plain.positions, atol=1e-6)
    np.testing.assert_array_equal(twice[0].positions, twice[1].positions)


def test_wrong_use_is_named():
    prepared = prepare(FACE)
    answer = prepared.solve(tolerance=1e-6)
    tangent = prepared.tangent(answer)
    other = prepare(Scene(X, TETS, [terms.Strain(1.0), PULL]))
    with pytest.raises(SceneError, match=r"metric: it has \d+ unknowns, the scene 378"):
        other.solve(metric=tangent)
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(SceneError, match="absolute: expected a gradient norm above 0 mN"):
            prepared.solve(absolute=bad)
    with pytest.raises(SceneError, match=r"moved targets: expected finite values of shape \(k, 42, 3\)"):
        tangent.vertices_by_targets(np.zeros((42, 3)))
    with pytest.raises(SceneError, match="other vertices, tets, bodies or held components"):
        tangent.vertices_by_scenes([[(other.scene, 1.0)]])
    touching = replace(FACE, terms=(*FACE.terms, terms.Contact(TRIANGLES)))
    with pytest.raises(SceneError, match="knows no Contact"):
        prepare(touching).tangent(answer)
