"""The saddle point's linear solver by GMRES, where factors are too big, and the choice between both.

The preconditioner is block triangular (Elman, Silvester and Wathen 2014, "Finite Elements and Fast Iterative Solvers",
Chapter 4): one V-cycle of multigrid for the displacement's block, and for the pressure's Schur complement the mass
matrix by 1/mu + 1/kappa, a few steps of Chebyshev's iteration between bounds that its elements give.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ..dolfinx_version import PETSc, free_dropped
from ..mesh.parallel import dot
from ..policy import POLICY, FenicsxPolicy, SaddlePolicy
from .multigrid import Multigrid, set_options
from .saddle import (
    SAME_PATTERN,
    FactoredSaddle,
    SaddleMatrix,
    SaddleStep,
    SaddleWork,
    set_diagonal,
)
from .solvers import LinearAnswer, hold, petsc_vector, solve_with

SADDLES = ("cg", "mumps", "block")
_PREFIX = "softdeca_block_"
_OPTIONS = {
    "fieldsplit_0_ksp_type": "preonly",
    "fieldsplit_0_pc_type": "none",  # until it is multigrid
    "fieldsplit_1_ksp_type": "preonly",
    "fieldsplit_1_pc_type": "ksp",
    "fieldsplit_1_ksp_ksp_type": "chebyshev",
    # The eigenvalues of diag(M)^-1 M on linear tets, whatever their weights (Wathen 1987, IMA J. Numer. Anal. 7:4).
    "fieldsplit_1_ksp_ksp_chebyshev_eigenvalues": "0.5,2.5",
    "fieldsplit_1_ksp_ksp_max_it": 5,
    "fieldsplit_1_ksp_ksp_norm_type": "none",
    "fieldsplit_1_ksp_pc_type": "jacobi",
}


def make_saddle_solver(
    kind: str, matrix: SaddleMatrix, held: Ints, policy: FenicsxPolicy = POLICY
) -> FactoredSaddle | BlockSaddle:
    """The solver of a name in SADDLES: "mumps" by factors, "block" by GMRES, "cg" either by the number of unknowns."""
    size = 3 * matrix.problem.numbering.nodes.total + matrix.problem.pressures.total
    iterative = kind == "block" or (kind == "cg" and size >= policy.saddle.large)
    return BlockSaddle(matrix, held, policy) if iterative else FactoredSaddle(matrix, held, policy.linear)


@dataclass(frozen=True, eq=False)
class LastSolves:
    """Findings of earlier solves about the next matrix.

    pace: GMRES' iterations for a decade of the residual, of the hardest projected system so far; 0 before the first.
    has_failed: whether the last solve found no answer, so that the next matrix is a projected one.
    """

    pace: float = 0.0
    has_failed: bool = False

    @property
    def expects_projected(self) -> bool:
        """Whether the next matrix is projected: the first one, or one after a failure."""
        return self.has_failed or not self.pace


class BlockSaddle:
    """See FactoredSaddle: the same system, the same questions.

    Nothing counts the inertia. A matrix with springs counts as positive definite unless one of two signs tells:

    - It curves the energy downwards along the answer, which then is no descent direction.
    - GMRES is `patience` times as slow as for the hardest projected matrix. Projected ones get all iterations.

    FactoredSaddle, `direct`, takes over for one of `newton_step` where GMRES does not find it. All that a call leaves
    for later ones is `last_solves`.
    """

    def __init__(self, matrix: SaddleMatrix, held: Ints, policy: FenicsxPolicy = POLICY):
        self._matrix, self._held, self._policy = matrix, held, policy.saddle
        self.work, self.last_solves = SaddleWork(), LastSolves()
        self.direct = FactoredSaddle(matrix, held, policy.linear, self.work)
        self._multigrid = Multigrid(matrix.H, matrix.problem.levels, symmetric=False)
        self._system: BlockSystem | None = None

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; held dofs' equations are x = b but for a factor, as `hold` leaves them."""
        answer, self.last_solves = self._solve(b, relative, self.last_solves)
        return answer

    def newton_step(self, residual: Floats) -> SaddleStep | None:
        """See FactoredSaddle; nothing counts the inertia here, so that it may be a saddle's step."""
        matrix, policy = self._matrix, self._policy
        hold(matrix.H, self._held, np.zeros(len(self._held)), np.zeros(matrix.displacements))
        system = self._set_up()
        answer = system.solve(-residual, policy.step)
        if not answer.converged:
            return self.direct.newton_step(residual)
        return SaddleStep(answer.x, lambda other: system.solve(-other, policy.following).x)

    def _solve(self, b: Floats, relative: float, before: LastSolves) -> tuple[LinearAnswer, LastSolves]:
        """The answer, and the last_solves after it."""
        matrix = self._matrix
        given = np.zeros_like(b)
        given[self._held] = b[self._held] / matrix.H.getDiagonal().array_r[self._held]
        projected = before.expects_projected
        volumes = np.zeros(matrix.pressures)
        matrix.B.multTranspose(*(petsc_vector(part, matrix.comm) for part in (given, volumes)))
        known = np.concatenate([b, -volumes])
        known[self._held] = 0.0
        slowest = np.inf if projected else self._policy.patience * before.pace
        answer = self._set_up().solve(known, relative, slowest)
        x, why, pace = answer.x[: len(b)], answer.why, before.pace
        if projected and not why:
            pace = max(pace, answer.iterations / -np.log10(relative))
        if not (why or dot(matrix.comm, x, b) > 0.0 or dot(matrix.comm, given, given) > 0.0):
            why = "negative curvature"
        x[self._held] = given[self._held]
        after = replace(before, pace=pace, has_failed=bool(why))
        return LinearAnswer(x, not why, answer.iterations, why), after

    def _set_up(self) -> BlockSystem:
        """Make GMRES anew for the matrix' present values."""
        self._drop_system()
        self._system = BlockSystem(self._matrix, self._held, self._multigrid, self._policy, self.work)
        return self._system

    def _drop_system(self):
        if self._system is not None:
            self._system.release()
        self._system = None
        free_dropped(self._matrix.comm)

    def release(self):
        """Free all that is kept."""
        self._drop_system()
        self.direct.release()


class BlockSystem:
    """GMRES and its preconditioner for a matrix' present values, where H holds the held displacements (k,).

    Volumes are scaled to be of the forces' size.
    """

    def __init__(self, matrix: SaddleMatrix, held: Ints, multigrid: Multigrid, policy: SaddlePolicy, work: SaddleWork):
        self._matrix, self._held, self._policy, self._work = matrix, held, policy, work
        free = np.ones(matrix.displacements, dtype=bool)
        free[held] = False
        stiffness = matrix.H.getDiagonal().array_r[free]
        self._scale = scale = policy.volume_weight * matrix.problem.force_per_volume(stiffness)
        B, D = matrix.B.copy(), matrix.D.copy()
        B.scale(scale)
        B.zeroRows((B.getOwnershipRange()[0] + held).astype(PETSc.IntType), diag=0.0)
        D.scale(scale**2)
        S = D.copy()
        S.axpy(-(scale**2), matrix.mass, structure=SAME_PATTERN)
        for part in (D, S):
            set_diagonal(part, matrix.idle, -1.0)
        transposed = B.transpose(PETSc.Mat())
        system = PETSc.Mat().createNest([[matrix.H, B], [transposed, D]], comm=matrix.comm)
        self._parts: list[PETSc.Mat] = [B, transposed, D, S, system]
        set_options(_PREFIX, _OPTIONS)
        self._ksp = ksp = PETSc.KSP().create(matrix.comm)
        ksp.setOptionsPrefix(_PREFIX)
        ksp.setType(PETSc.KSP.Type.FGMRES)
        ksp.setGMRESRestart(policy.restart)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setOperators(system)
        blocks = ksp.getPC()
        blocks.setType(PETSc.PC.Type.FIELDSPLIT)
        rows, _ = system.getNestISs()
        blocks.setFieldSplitIS(("0", rows[0]), ("1", rows[1]))
        blocks.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
        blocks.setFieldSplitSchurFactType(PETSc.PC.SchurFactType.UPPER)
        blocks.setFieldSplitSchurPreType(PETSc.PC.SchurPreType.USER, S)
        ksp.setFromOptions()
        ksp.setUp()
        multigrid.set_up(blocks.getFieldSplitSubKSP()[0].getPC())
        work.systems += 1

    def solve(self, known: Floats, relative: float, slowest: float = np.inf) -> LinearAnswer:
        """Displacements and pressures from forces and volumes, a vector.

        GMRES ends where it takes more than `slowest` iterations for a decade, after as many for a decade in advance.
        """
        known = np.array(known)
        known[self._matrix.displacements :] *= self._scale
        reasons, first = PETSc.KSP.ConvergedReason, 0.0

        def judge(_ksp: PETSc.KSP, iteration: int, residual: float) -> int:
            nonlocal first
            if not np.isfinite(residual):
                return reasons.DIVERGED_NANORINF
            first = residual if iteration == 0 else first
            if residual <= relative * first:
                return reasons.CONVERGED_RTOL
            is_slow = iteration > slowest * (1.0 + np.log10(first / residual))
            return reasons.DIVERGED_MAX_IT if is_slow else reasons.ITERATING

        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=self._policy.max_iterations)
        self._ksp.setConvergenceTest(judge)
        x, why = solve_with(self._ksp, known, 1)
        x[self._matrix.displacements :] *= self._scale
        x[self._held] = 0.0  # GMRES leaves its residual there
        iterations = self._ksp.its
        self._work.iterations += iterations
        return LinearAnswer(x, not why, iterations, why)

    def release(self):
        """Free all that is kept; PETSc's objects outlive Python's until they are destroyed."""
        self._ksp.destroy()
        for part in reversed(self._parts):
            part.destroy()
