"""Promises of a prepared scene's solve: options, warm starts, nothing factored twice, a falling energy, speed."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csc_matrix, diags, random_array

from softdeca.lhm.base.geometry import cholesky
from softdeca.reference import Reason, Scene, prepare, solve, terms
from softdeca.reference.projective.policy import ProjectivePolicy
from softdeca.reference.projective.terms.energy import Energy
from softdeca.reference.projective.unknowns import system


def head_scene(head, amplitude=6.0):
    """Gravity, an expression of the skin, a held cranium: soft tissue of nu = .45, weak muscle."""
    n, soft = len(head.skin_wrap.vertices), np.arange(len(head.soft.tets))
    muscle = soft + len(soft)
    X = head.skin_wrap.vertices
    push = amplitude * np.exp(-np.sum((X / 100.0 - [0, -0.3, 0.95]) ** 2, axis=1) / 0.1)[:, None] * [0.3, -1, 0.2]
    return Scene(
        head.vertices,
        head.tets,
        [
            terms.Strain(5.0, tets=soft),
            terms.Volume(13.5 * 5.0, tets=soft),
            terms.Strain(0.25, limit=1.05, tets=muscle),
            terms.Volume(13.5 * 5.0, tets=muscle),
            terms.SurfaceStrain(head.skin_wrap.triangles, 60.0),
            terms.Target(np.arange(n), X + push, 10.0 * head.skin_wrap.vertex_areas),
            terms.Fixed(2 * n + np.flatnonzero(head.bone == 1), 1.0 * head.skull_wrap.vertices[head.bone == 1]),
            terms.Gravity((0, -9810, 0), 1.04e-6),
        ],
    )


@pytest.fixture(scope="module")
def scene(sphere_head):
    return head_scene(sphere_head)


def test_a_varied_scene_is_solved_without_factoring(scene, monkeypatch):
    calls = []
    factorise = system.factorise_definite
    monkeypatch.setattr(system, "factorise_definite", lambda *a, **k: calls.append(1) or factorise(*a, **k))
    prepared = prepare(scene)
    assert len(calls) == 1
    changes = {
        terms.Strain: {"limit": 1.1},
        terms.Volume: {"target": 1.2},
        terms.SurfaceStrain: {"growth": 1.1},
        terms.Target: {"positions": scene.of(terms.Target)[0].positions + 1.0},
        terms.Fixed: {"values": scene.of(terms.Fixed)[0].values + 0.5},
        terms.Gravity: {"acceleration": (9810, 0, 0), "density": 2e-6},
    }
    varied = replace(scene, terms=[replace(term, **changes[type(term)]) for term in scene.terms])
    again = prepared.solve(varied, tolerance=1e-9)
    assert len(calls) == 1 and again.detail["factorisations"] == 1
    np.testing.assert_allclose(again.positions, solve(varied, tolerance=1e-9).positions, atol=1e-6)
    assert np.abs(again.positions - prepared.solve(tolerance=1e-9).positions).max() > 0.5


def test_plain_descends_monotonically_to_what_lbfgs_finds(scene):
    """At a volume to strain ratio of 13.5; and L-BFGS needs at most a fifth of the iterations to 0.01 mm."""
    limit = solve(scene, tolerance=1e-11).positions
    needed = {}
    for method in ("plain", "lbfgs"):
        far = []

        def near_enough(i, x, energy, norm, far=far):
            far.append(np.linalg.norm(x - limit, axis=1).max())
            return far[-1] < 0.01

        solution = prepare(scene, method=method).solve(max_iterations=3000, tolerance=1e-12, on_iteration=near_enough)
        assert solution.reason is Reason.INTERRUPTED
        needed[method] = solution.iterations
        if method == "plain":
            assert (np.diff(solution.history.energy) <= 1e-12 * abs(solution.energy)).all()
    assert 5 * needed["lbfgs"] <= needed["plain"]


def test_less_of_the_volume_in_the_matrix_saves_iterations(scene):
    """The minimum is the same, and A with a share of 1 is that of Strain alone with Volume's weight added."""
    few = solve(scene, tolerance=1e-9)
    many = solve(scene, tolerance=1e-9, policy=ProjectivePolicy(volume_share_lbfgs=1.0))
    assert few.converged and few.iterations < 0.8 * many.iterations
    np.testing.assert_allclose(few.positions, many.positions, atol=1e-5)
    strains = [terms.Strain(term.stiffness, tets=term.tets) for term in scene.of(terms.Volume)]
    as_strain = replace(scene, terms=[term for term in scene.terms if not isinstance(term, terms.Volume)] + strains)
    half, whole = (Energy.from_scene(scene).matrix(scene, volume_share=share)[0] for share in (0.5, 1.0))
    added = Energy.from_scene(as_strain).matrix(as_strain)[0]
    none = Energy.from_scene(scene).matrix(scene, volume_share=0.0)[0]
    assert abs(whole - added).max() <= 1e-12 * abs(added).max()
    assert abs(2.0 * half - whole - none).max() <= 1e-12 * abs(added).max()


def test_a_tolerance_below_rounding_ends_at_rounding(scene):
    solution = solve(scene, tolerance=1e-30)
    assert solution.reason in (Reason.ROUNDING, Reason.STAGNATED)
    assert solution.history.gradient_norm.min() < 1e-12 * solution.history.gradient_norm[0]


def test_held_components_are_exact_and_factored_by_mask(scene):
    n = len(scene.vertices)
    slide = [*scene.terms[:6], terms.Fixed([n - 1], scene.vertices[[n - 1]] + 0.1, components=1)]
    prepared = prepare(replace(scene, terms=slide))
    solution = prepared.solve()
    assert solution.detail["factorisations"] == 2  # x and z agree, y does not
    assert solution.positions[n - 1, 1] == scene.vertices[n - 1, 1] + 0.1
    assert solution.positions[n - 1, 0] != scene.vertices[n - 1, 0]


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
def test_every_linear_solver_solves(name):
    right = np.random.default_rng(1).normal(size=(200, 5))
    expected = np.linalg.solve(matrix().toarray(), right)
    solve = cholesky.factorise(matrix(), linear_solver=name)
    np.testing.assert_allclose(solve(right), expected, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(solve))(right), solve(right))


@cholmod_is_there
@pytest.mark.parametrize("size", [2, 30, 200])
def test_cholmod_tells_definite_matrices_from_others(size, capfd):
    rng = np.random.default_rng(0)
    symmetric = rng.normal(size=(size, size))
    symmetric += symmetric.T
    lowest = np.linalg.eigvalsh(symmetric).min()
    with pytest.raises(np.linalg.LinAlgError):
        cholesky.CholmodFactor(csc_matrix(symmetric - 0.9 * lowest * np.eye(size)))
    definite = csc_matrix(symmetric - 1.1 * lowest * np.eye(size))
    solve = cholesky.CholmodFactor(definite)
    first, second = rng.normal(size=(2, size, 1))
    x, y = solve(first), solve(second)  # an answer is not overwritten by the next
    assert np.allclose(definite @ x, first) and np.allclose(definite @ y, second)
    assert capfd.readouterr() == ("", "")


def test_anderson_finds_the_same_minimum_in_far_fewer_steps_than_plain(sphere_head):
    scene = scene_of(sphere_head, shift=10.0)
    mixed, steps = (prepare(scene, method=method).solve(tolerance=1e-6) for method in ("anderson", "plain"))
    assert mixed.converged and steps.converged
    assert 4 * mixed.iterations < steps.iterations
    assert (np.diff(mixed.history.energy) <= 1e-12 * mixed.history.energy[1:]).all()
    np.testing.assert_allclose(mixed.positions, solve(scene, tolerance=1e-9).positions, atol=1e-3)
