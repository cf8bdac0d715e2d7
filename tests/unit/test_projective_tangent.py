"""Factors of the exact Hessian: their answers, raised eigenvalues, reuse, and a metric for descent."""

import numpy as np
import pytest

from softdeca.lhm.base.geometry import cholesky
from softdeca.reference import Parameters, facial_scene, prepare
from softdeca.surrogate.corpus.spheres import Spheres

from .by_solver import projective_hessian

SPACE = Spheres(1)
HEAD = SPACE.fit(SPACE.skin(np.zeros(4)))
X, TETS = HEAD.vertices, HEAD.tets
FACE = facial_scene(HEAD, Parameters(skin_bending=20.0, gravity=2.0), HEAD.skin.vertices)


def test_a_tangent_is_factored_and_reused_like_another():
    prepared = prepare(FACE)
    answer = prepared.solve(tolerance=1e-10)
    tangent = prepared.tangent(answer)
    assert tangent.is_exact
    matrix = projective_hessian(prepared, tangent.place)
    right = np.random.default_rng(0).normal(size=(len(matrix), 3))
    np.testing.assert_allclose(matrix @ tangent.solve(right), right, atol=1e-8)
    np.testing.assert_array_equal(tangent.solve(right[:, 0]).shape, (len(matrix),))
    softer = prepare(facial_scene(HEAD, Parameters(soft_stiffness=2.0, skin_bending=5.0), HEAD.skin.vertices + 1.0))
    second = softer.tangent(softer.solve(tolerance=1e-10))
    assert second.sparsity is tangent.sparsity
    if cholesky.has_cholmod():
        assert second.factor.analysis is tangent.factor.analysis
    np.testing.assert_allclose(projective_hessian(softer, second.place) @ second.solve(right), right, atol=1e-8)


@pytest.mark.parametrize("linear_solver", ["cholespy", "superlu", "cholmod"])
def test_indefinite_tangents_are_raised_and_say_so(linear_solver, capfd):
    if linear_solver == "cholmod" and not cholesky.has_cholmod():
        pytest.skip("scikit-sparse is not installed")
    prepared = prepare(FACE)
    squeezed = prepared.solve(start=0.7 * X, max_iterations=0, untangle=False)
    tangent = prepared.tangent(squeezed, linear_solver=linear_solver)
    assert not tangent.is_exact
    right = np.random.default_rng(0).normal(size=tangent.coordinates.size)
    np.testing.assert_allclose(
        projective_hessian(prepared, tangent.place, 0.0) @ tangent.solve(right), right, atol=1e-5
    )
    assert prepared.tangent(prepared.solve(tolerance=1e-9), linear_solver=linear_solver).is_exact


def test_without_cholmod_tangents_are_the_same(monkeypatch):
    prepared = prepare(FACE)
    answer = prepared.solve(tolerance=1e-9)
    right = np.random.default_rng(0).normal(size=prepared.system.coordinates.size)
    steps = [prepared.tangent(answer).solve(right)]
    monkeypatch.setattr(cholesky, "has_cholmod", lambda: False)
    steps.append(prepared.tangent(answer).solve(right))
    steps.append(prepared.tangent(answer, linear_solver="superlu").solve(right))
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
