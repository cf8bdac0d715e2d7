"""Linear solvers over a sequence of matrices: what they promise of the residual, whatever set-up they have kept."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

from softdeca.reference import Scene, materials, terms
from softdeca.reference.fenicsx.dolfinx_version import PETSc
from softdeca.reference.fenicsx.energy.surface_strain import _planar_svd
from softdeca.reference.fenicsx.linear.problem import DiscreteProblem
from softdeca.reference.fenicsx.linear.solvers import LINEAR_SOLVERS, ConjugateGradients, hold
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.problems import meshes


@pytest.fixture
def box():
    """A problem on a box of neo-Hookean tissue, what it holds, and a right-hand side."""
    X, tets = meshes.unstructured(6, 3.0)
    scene = Scene(X, tets, [terms.Hyperelastic(materials.NeoHookean.from_young(15.0, 0.45))])
    problem = DiscreteProblem(scene, Numbering(scene))
    x = problem.numbering.X
    return problem, np.flatnonzero(np.repeat(x[:, 2] < 1e-9, 3)), np.random.default_rng(0).normal(size=x.size)


def solved(solver, problem, held, stretch, shift, b, relative):
    """The answer at a stretch along z, to a Hessian less a multiple of the identity, and its true residual."""
    matrix = problem.at(problem.numbering.X * [0.0, 0.0, stretch - 1.0]).hessian(0.0)
    matrix.shift(-shift * matrix.getDiagonal().norm())
    right = np.array(b)
    hold(matrix, held, np.zeros(len(held)), right)
    indptr, columns, values = matrix.getValuesCSR()
    given = np.array(right)
    answer = solver.solve(right, relative=relative)
    residual = np.linalg.norm(csr_matrix((values, columns, indptr)) @ answer.x - given) / np.linalg.norm(given)
    return answer, residual


@pytest.mark.parametrize("kind", LINEAR_SOLVERS)
def test_residual_is_what_was_asked_while_the_matrix_changes(box, kind):
    solver = LINEAR_SOLVERS[kind](box[0].matrix)
    for stretch in (1.0, 1.01, 1.02, 1.5, 4.0, 0.3, 1.0, 1.0):
        for relative in (1e-2, 1e-8):
            answer, residual = solved(solver, box[0], box[1], stretch, 0.0, box[2], relative)
            assert answer.converged and residual <= 1.01 * relative, (stretch, relative, answer.why)


def test_multigrid_has_the_rigid_motions_before_its_set_up():
    """Without them nothing warns, and a slender bar takes twice the iterations."""
    X, tets = meshes.box((3, 3, 24), (1.0, 1.0, 8.0))
    scene = Scene(X, tets, [terms.Hyperelastic(materials.NeoHookean.from_young(10.0, 0.45))])
    counts = []
    for motions in (True, False):
        problem = DiscreteProblem(scene, Numbering(scene))
        x = problem.numbering.X
        if not motions:
            problem.matrix.setNearNullSpace(PETSc.NullSpace())
        held, b = np.flatnonzero(np.repeat(x[:, 2] < 1e-9, 3)), np.tile([1.0, 0.0, 0.0], len(x))
        counts.append(solved(ConjugateGradients(problem.matrix), problem, held, 1.0, 0.0, b, 1e-8)[0].iterations)
    assert counts[0] < 0.6 * counts[1], counts


@pytest.mark.parametrize("kind", LINEAR_SOLVERS)
@pytest.mark.parametrize("first", [True, False])
def test_indefinite_matrices_are_told_and_forgotten(box, kind, first):
    solver = LINEAR_SOLVERS[kind](box[0].matrix)
    if not first:
        assert solved(solver, box[0], box[1], 1.0, 0.0, box[2], 1e-6)[0].converged
    for _ in range(3):
        assert not solved(solver, box[0], box[1], 1.0, 0.1, box[2], 1e-6)[0].converged
    answer, residual = solved(solver, box[0], box[1], 1.1, 0.0, box[2], 1e-6)
    assert answer.converged and residual <= 1.01e-6


def flat_prisms():
    """Thin layers of tissue that are held below, and their columns from face to face."""
    X, tets = meshes.box((10, 10, 8), (10.0, 10.0, 0.8))
    solid = terms.Hyperelastic(materials.NeoHookean.from_young(15.0, 0.45))
    return Scene(X, tets, (solid, terms.Fixed(meshes.vertices_at(X, 2, 0.0)))), np.arange(len(X)).reshape(-1, 9)


@pytest.mark.parametrize(("degree", "layered", "share"), [(1, True, 0.6), (2, False, 0.95), (2, True, 0.75)])
def test_levels_of_the_mesh_spare_iterations_and_keep_the_residual(degree, layered, share):
    scene, columns = flat_prisms()
    if layered:
        scene = replace(scene, columns=(columns[:, :5], columns[:, 4:]))
    problem = DiscreteProblem(scene, Numbering(scene, degree))
    x = problem.numbering.X
    held = problem.held_dofs(problem.numbering.held(scene.dirichlet()[0]))
    b = np.random.default_rng(0).normal(size=x.size)
    counts = []
    for levels in ([], problem.levels):
        solver = ConjugateGradients(problem.matrix, levels)
        steps = [solved(solver, problem, held, stretch, 0.0, b, 1e-6) for stretch in (1.0, 1.1)]
        assert all(answer.converged and residual <= 1.01e-6 for answer, residual in steps)
        counts.append(sum(answer.iterations for answer, _ in steps))
    assert counts[1] <= share * counts[0], counts


def test_frames_of_triangles():
    rng = np.random.default_rng(1)
    F = rng.normal(size=(40, 3, 2))
    F[:5, :, 1] = 2.0 * F[:5, :, 0]
    F[5:8, :, 0] *= 1e-9
    F[8] = 0.0
    F[9] = [[0.0, 0.0], [3.0, 0.0], [0.0, 0.0]]
    U, s, Vt = _planar_svd(F)
    assert np.allclose((U[:, :, :2] * s[:, None, :]) @ Vt, F, atol=1e-14)
    assert np.allclose(U.transpose(0, 2, 1) @ U, np.eye(3), atol=1e-14)
    assert np.allclose(Vt @ Vt.transpose(0, 2, 1), np.eye(2), atol=1e-14)
    assert np.allclose(s, np.linalg.svd(F, compute_uv=False), atol=1e-14) and (s[:, 0] >= s[:, 1]).all()
