"""Displacement and pressure by GMRES: the direct solver's answers, what it refuses, and whole solves either way."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve

from softdeca.reference import Scene, solve, terms
from softdeca.reference.fenicsx.linear.problem import DiscreteProblem
from softdeca.reference.fenicsx.linear.saddle_block import make_saddle_solver
from softdeca.reference.fenicsx.linear.solvers import hold
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.fenicsx.policy import FenicsxPolicy, SaddlePolicy
from softdeca.reference.fenicsx.strategies.multipliers import Condensed
from softdeca.reference.problems import meshes

from .test_fenicsx_multipliers import LAWS, descend, each_law


def standing(law, cells=3, density=2e-4):
    """A box [mm] on its base, under its own weight and a corner's spring."""
    X, tets = meshes.box((cells, cells, cells))
    corner = np.flatnonzero((X == X.max(axis=0)).all(axis=1))
    pull = terms.Target(corner, X[corner] + [0.3, 0.2, 0.1], 0.1)
    weight = terms.Gravity((2.0, 0.0, -9.81), density=density)
    return Scene(X, tets, [terms.Hyperelastic(law), terms.Fixed(meshes.vertices_at(X, 2, 0.0)), pull, weight])


def strained(law, cells=3, by=0.1):
    """A condensed problem at a displacement that is no equilibrium, its state, and what is held."""
    scene = standing(law, cells)
    problem = DiscreteProblem(scene, Numbering(scene, 2), mixed=True)
    condensed = Condensed(problem)
    X = problem.numbering.X
    u = by * np.stack([X[:, 2] * X[:, 1], X[:, 2] ** 2, -X[:, 2] * X[:, 0]], axis=1)
    held = np.flatnonzero(np.repeat(X[:, 2] < 1e-9, 3))
    return condensed, condensed.at(u), held


def condensed_residual(condensed, held, x, b):
    """Residual of the displacement's equations alone, without the held dofs' rows and columns, over b's norm."""
    H = csr_matrix(condensed.problem.matrix.getValuesCSR()[::-1])
    B, D = (csr_matrix(part.getValuesCSR()[::-1]) for part in (condensed.matrix.B, condensed.matrix.D))
    B = diags(np.isin(np.arange(len(b)), held, invert=True).astype(float)) @ B
    away = H @ x - B @ spsolve(D.tocsc(), B.T @ x) - b
    return np.linalg.norm(away) / np.linalg.norm(b)


@each_law
@pytest.mark.parametrize("relative", [1e-2, 1e-6, 1e-10])
def test_what_newton_asks_of_the_residual(law, relative):
    condensed, state, held = strained(law)
    solver = make_saddle_solver("block", condensed.matrix, held)
    b = -state.gradient().ravel()
    hold(state.hessian(0.0), held, np.zeros(len(held)), b)
    answer = solver.solve(b, relative=relative)
    assert answer.converged and 1 < answer.iterations < 80
    assert condensed_residual(condensed, held, answer.x, b) <= relative
    solver.release()


@each_law
def test_held_motions_spread_as_by_factors(law):
    condensed, state, held = strained(law)
    values = np.sin(np.arange(len(held)))
    answers = []
    for kind in ("mumps", "block"):
        b = np.zeros(state.u.size)
        hold(state.hessian(0.0), held, values, b)
        solver = make_saddle_solver(kind, condensed.matrix, held)
        answers.append(solver.solve(b, relative=1e-10))
        solver.release()
    assert answers[0].converged and answers[1].converged
    assert np.allclose(answers[1].x[held], values, rtol=1e-14)
    assert np.abs(answers[0].x - answers[1].x).max() < 1e-7


def test_iterations_grow_slowly_with_the_mesh():
    counts = []  # on 48, 384 and 3072 tets
    for cells in (2, 4, 8):
        condensed, state, held = strained(LAWS["incompressible"], cells)
        solver = make_saddle_solver("block", condensed.matrix, held)
        b = -state.gradient().ravel()
        hold(state.hessian(0.0), held, np.zeros(len(held)), b)
        counts.append(solver.solve(b, relative=1e-6).iterations)
        solver.release()
    assert counts[2] < 2 * counts[0]


@each_law
def test_a_box_under_load_ends_where_it_does_by_factors(law):
    scene = standing(law, density=2e-5)
    direct, iterative = (
        solve(scene, solver="fenicsx", element="P2P1", linear_solver=kind, tolerance=1e-10)
        for kind in ("mumps", "block")
    )
    assert direct.converged and iterative.converged, (direct.reason, iterative.reason)
    assert np.abs(direct.positions - scene.vertices).max() > 0.01
    assert np.abs(direct.positions - iterative.positions).max() < 1e-8
    assert iterative.detail["linear_iterations"] > 3 * iterative.detail["linear_solves"]


def test_factors_step_in_where_gmres_gives_up():
    scene = standing(LAWS["incompressible"])
    options = {"solver": "fenicsx", "element": "P2P1", "linear_solver": "block", "tolerance": 1e-9}
    expected = solve(scene, **options)
    hasty = FenicsxPolicy(saddle=SaddlePolicy(restart=1, max_iterations=30))
    solution = solve(scene, policy=hasty, **options)
    assert solution.converged and np.abs(solution.positions - expected.positions).max() < 1e-7
    assert solution.detail["linear_solves"] > expected.detail["linear_solves"]


def test_a_column_buckles_by_factors():
    """Pressed straight down it has an equilibrium that stays straight, which is no minimum and costs a third more."""
    X, tets = meshes.box((2, 2, 10))
    X = X * [1.0, 1.0, 8.0]
    ends = [meshes.vertices_at(X, 2, end) for end in (0.0, 8.0)]
    goal = np.concatenate([X[ends[0]], X[ends[1]] - [0.0, 0.0, 0.8]])
    scene = Scene(X, tets, [terms.Hyperelastic(LAWS["incompressible"]), terms.Fixed(np.concatenate(ends), goal)])
    found = descend(scene, tolerance=1e-8, linear_solver="mumps")
    assert found.converged, found.reason
    assert np.abs(found.positions - X)[:, :2].max() > 1.0
