"""Linear solvers, a symbolic factorisation used again, Anderson's mixing, and warm starts of a sequence."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csc_matrix, diags, random_array

from softdeca.lhm.base.errors import InputError, MissingDependencyError
from softdeca.lhm.base.geometry import cholesky
from softdeca.reference import Scene, SceneError, prepare, solve, terms

cholmod_is_there = pytest.mark.skipif(not cholesky.has_cholmod(), reason="scikit-sparse is not installed")
SOLVERS = ["cholespy", "superlu", pytest.param("cholmod", marks=cholmod_is_there)]


def matrix(size=200, seed=0):
    entries = random_array((size, size), density=0.02, rng=np.random.default_rng(0))
    scale = diags(np.random.default_rng(seed).uniform(1.0, 2.0, size))
    return csc_matrix(scale @ (entries @ entries.T + diags(np.full(size, 0.1))) @ scale)


def scene_of(head, stiffness=5.0, scale=1.0, shift=0.0):
    skin = head.skin_wrap.vertices
    pull = (
        skin + shift * np.array([0.0, -1.0, 0.5]) * np.exp(-np.sum((skin / 60.0 - [0, 0, 1.6]) ** 2, axis=1))[:, None]
    )
    held = 2 * len(skin) + np.flatnonzero(head.bone == 1)
    return Scene(
        scale * head.vertices,
        head.tets,
        [
            terms.Strain(stiffness),
            terms.Volume(13.5 * stiffness),
            terms.Target(np.arange(len(skin)), scale * pull, 10.0 * head.skin_wrap.vertex_areas),
            terms.Fixed(held),
        ],
    )


@pytest.mark.parametrize("name", SOLVERS)
def test_every_linear_solver_solves(name, sphere_head):
    right = np.random.default_rng(1).normal(size=(200, 5))
    expected = np.linalg.solve(matrix().toarray(), right)
    np.testing.assert_allclose(cholesky.factorise(matrix(), linear_solver=name)(right), expected, rtol=1e-8, atol=1e-8)
    scene = scene_of(sphere_head, shift=8.0)
    positions = prepare(scene, linear_solver=name).solve(tolerance=1e-9).positions
    np.testing.assert_allclose(positions, solve(scene, tolerance=1e-9).positions, atol=1e-5)


@cholmod_is_there
@pytest.mark.parametrize("size", [2, 30, 200])
def test_cholmod_tells_definite_matrices_from_others(size, capfd):
    rng = np.random.default_rng(0)
    symmetric = rng.normal(size=(size, size))
    symmetric += symmetric.T
    lowest = np.linalg.eigvalsh(symmetric).min()
    with pytest.raises(np.linalg.LinAlgError):
        cholesky.CholmodFactor(csc_matrix(symmetric - 0.9 * lowest * np.eye(size)), definite=True)
    definite = csc_matrix(symmetric - 1.1 * lowest * np.eye(size))
    solve = cholesky.CholmodFactor(definite, definite=True)
    first, second = rng.normal(size=(2, size, 1))
    x, y = solve(first), solve(second)  # an answer is not overwritten by the next
    assert np.allclose(definite @ x, first) and np.allclose(definite @ y, second)
    assert capfd.readouterr() == ("", "")


@cholmod_is_there
def test_cholmod_takes_over_an_analysis_where_the_pattern_fits():
    first = cholesky.CholmodFactor(matrix())
    second = cholesky.CholmodFactor(matrix(seed=5), like=first)
    assert second.analysis is first.analysis
    right = np.random.default_rng(1).normal(size=(200, 3))
    for made, seed in ((second, 5), (first, 0)):
        np.testing.assert_allclose(made(right), np.linalg.solve(matrix(seed=seed).toarray(), right), atol=1e-8)
    assert cholesky.CholmodFactor(matrix(150), like=first).analysis is not first.analysis
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        cholesky.CholmodFactor(-matrix())


@cholmod_is_there
def test_another_identity_is_prepared_like_the_first(sphere_head):
    first = prepare(scene_of(sphere_head), linear_solver="cholmod")
    scene = scene_of(sphere_head, stiffness=7.0, scale=1.1, shift=5.0)
    second = prepare(scene, linear_solver="cholmod", like=first)
    assert second.system.groups[0].solver.analysis is first.system.groups[0].solver.analysis
    np.testing.assert_allclose(
        second.solve(tolerance=1e-9).positions, solve(scene, tolerance=1e-9).positions, atol=1e-5
    )


def test_linear_solvers_that_are_not_there_are_named(sphere_head, monkeypatch):
    with pytest.raises(InputError, match="linear solver 'pardiso': expected one of cholespy, cholmod, superlu"):
        prepare(scene_of(sphere_head), linear_solver="pardiso")
    monkeypatch.setattr(cholesky, "has_cholmod", lambda: False)
    monkeypatch.setattr(cholesky, "CholeskySolverD", None)
    for name in ("cholmod", "cholespy"):
        with pytest.raises(MissingDependencyError, match=f"linear solver '{name}' needs"):
            cholesky.factorise(matrix(), linear_solver=name)


def test_anderson_finds_the_same_minimum_in_far_fewer_steps_than_plain(sphere_head):
    scene = scene_of(sphere_head, shift=10.0)
    mixed, steps = (prepare(scene, method=method).solve(tolerance=1e-6) for method in ("anderson", "plain"))
    assert mixed.converged and steps.converged
    assert 4 * mixed.iterations < steps.iterations
    assert (np.diff(mixed.history.energy) <= 1e-12 * mixed.history.energy[1:]).all()
    np.testing.assert_allclose(mixed.positions, solve(scene, tolerance=1e-9).positions, atol=1e-3)


def test_a_warm_start_saves_steps_and_hides_no_state(sphere_head):
    scenes = [scene_of(sphere_head, shift=shift) for shift in (8.0, 8.5, 9.0)]
    prepared = prepare(scenes[0])
    first = prepared.solve(scenes[0], remember=True)
    second = prepared.solve(scenes[1], warm=first, remember=True)
    assert prepared.solve(scenes[1], warm=first).memory is None and len(second.memory) > 0
    third = prepared.solve(scenes[2], warm=second)
    again = prepared.solve(scenes[1], warm=first)
    np.testing.assert_array_equal(again.positions, second.positions)
    np.testing.assert_array_equal(again.history.energy, second.history.energy)
    absolute = 1e-6 * first.history.gradient_norm[0]

    def enough(i, x, energy, norm):
        return norm <= absolute

    cold = prepared.solve(scenes[2], tolerance=1e-12, on_iteration=enough)
    warm = prepared.solve(scenes[2], tolerance=1e-12, on_iteration=enough, warm=second)
    assert warm.iterations < cold.iterations
    np.testing.assert_allclose(third.positions, solve(scenes[2], tolerance=1e-9).positions, atol=1e-4)
    other = prepare(replace(scenes[0], terms=scenes[0].terms[:3]))
    assert other.solve(warm=first).converged  # of other unknowns: only its positions are of use


def test_threads_share_the_local_step_and_change_nothing(sphere_head):
    scene = scene_of(sphere_head, shift=5.0)
    alone = prepare(scene).solve(tolerance=1e-9)
    shared = [prepare(scene, threads=threads).solve(tolerance=1e-9).positions for threads in (3, 3, 200)]
    assert np.array_equal(shared[0], shared[1])
    assert shared[0] == pytest.approx(alone.positions, abs=1e-7) == shared[2]
    for wrong in (0, 1.5, True):
        with pytest.raises(SceneError, match="threads must be from 1 to 256"):
            prepare(scene, threads=wrong)
