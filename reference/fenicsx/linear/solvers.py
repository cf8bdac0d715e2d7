"""Linear solvers by name: conjugate gradients with algebraic multigrid, and MUMPS' factors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ..dolfinx_version import PETSc, free_dropped
from ..policy import POLICY, LinearPolicy
from .multigrid import CoarseLevel, Multigrid

_PREFIX = "softdeca_cg_"
INDEFINITE = ("DIVERGED_INDEFINITE_MAT", "DIVERGED_INDEFINITE_PC")  # CG blames either for a matrix that is


@dataclass(frozen=True, eq=False)
class LinearAnswer:
    """x, a vector, whether it solves the system, the iterations it took, and a word on why not."""

    x: Floats
    converged: bool
    iterations: int
    why: str = ""


class LinearSolver(Protocol):
    """Solves A x = b with the present values of the matrix that it was made for, by all ranks that share it."""

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """Give x with a residual below `relative` times b's norm, if A is positive definite."""
        ...


class ConjugateGradients:
    """CG with multigrid; GAMG's aggregates come from the matrix' near-null space of rigid motions.

    A set-up of multigrid costs as much as `policy.setup` iterations. It is kept while the matrix' values change, until
    it has cost that much in iterations beyond those that it took when it was new. `levels` are as of `Multigrid`.
    """

    def __init__(self, matrix: PETSc.Mat, levels: Sequence[CoarseLevel] = (), *, policy: LinearPolicy = POLICY.linear):
        self._matrix, self._multigrid, self._policy = matrix, Multigrid(matrix, levels), policy
        self._start_over()

    def _start_over(self):
        self._ksp = PETSc.KSP().create(self._matrix.comm)
        self._ksp.setOptionsPrefix(_PREFIX)
        self._ksp.setType(PETSc.KSP.Type.CG)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._ksp.setOperators(self._matrix)
        self._discard_setup()

    def _discard_setup(self):
        """Have multigrid set up anew at the next solve."""
        self._per_decade, self._wear, self._doubtful = 0.0, 0.0, False

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; a direction of negative curvature counts as no solution."""
        before = 0
        if self._per_decade:
            answer = self._solve_by_kept_setup(b, relative)
            if answer.converged or self._per_decade:
                return answer
            before = answer.iterations
        self._ksp.getPC().setReusePreconditioner(False)
        self._multigrid.set_up(self._ksp.getPC())
        answer = self._solve(b, relative, self._policy.max_iterations)
        if answer.converged:
            self._ksp.getPC().setReusePreconditioner(True)
            self._per_decade = max(answer.iterations, 1) / -np.log10(relative)
        else:
            self._start_over()  # GAMG does not recover from values that were indefinite, or that it failed for
        return replace(answer, iterations=before + answer.iterations)

    def _solve_by_kept_setup(self, b: Floats, relative: float) -> LinearAnswer:
        """Solve by the last set-up, in not many more iterations than another one would take."""
        expected = self._per_decade * -np.log10(relative)
        answer = self._solve(b, relative, int(expected + 2 * self._policy.setup))
        if answer.why in INDEFINITE and not self._doubtful:
            self._doubtful = True  # twice in a row, and the set-up is to blame
            return answer
        self._doubtful = False
        self._wear = max(self._wear + answer.iterations - expected, 0.0)
        if self._wear > self._policy.setup or not answer.converged:
            self._discard_setup()
        return answer

    def _solve(self, b: Floats, relative: float, limit: int) -> LinearAnswer:
        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=limit)
        x, why = solve_with(self._ksp, b)
        return LinearAnswer(x, not why, self._ksp.its, why)


class Factorisation:
    """Factors a matrix, always the same one, whenever its values have changed; the elimination's order is kept.

    `solve` uses the last factors. After `factor`, `negative` is the number of negative pivots of a symmetric matrix.
    """

    def __init__(self, policy: LinearPolicy = POLICY.linear):
        self._policy = policy
        self._ksp: PETSc.KSP | None = None
        self.negative = 0
        self.symmetric = True

    def factor(self, matrix: PETSc.Mat, *, symmetric: bool) -> bool:
        """Factor a matrix that ranks share; give whether it is regular.

        One that need not be `symmetric` is tested for it.
        """
        size = matrix.norm(PETSc.NormType.FROBENIUS)
        if not np.isfinite(size):
            return False
        if not symmetric:
            difference = matrix.transpose(PETSc.Mat())
            difference.axpy(-1.0, matrix)
            symmetric = difference.norm(PETSc.NormType.FROBENIUS) <= self._policy.asymmetry * size
            difference.destroy()
        if self._ksp is None or symmetric != self.symmetric:
            self.release()
            self._analyse(matrix, symmetric)
        assert self._ksp is not None
        self._ksp.setOperators(matrix)  # else values that change twice between solves go unseen
        factors = self._ksp.getPC().getFactorMatrix()
        try:
            self._ksp.setUp()
            regular = factors.getMumpsInfog(1) >= 0
        except PETSc.Error:
            regular = False
        if not regular:
            self.release()
            return False
        self.negative = factors.getMumpsInfog(12) if self.symmetric else 0
        return True

    def _analyse(self, matrix: PETSc.Mat, symmetric: bool):
        self.symmetric = symmetric
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.setOperators(matrix)
        preconditioner = self._ksp.getPC()
        preconditioner.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
        preconditioner.setFactorSolverType("mumps")
        preconditioner.setFactorSetUpSolverType()
        factors = preconditioner.getFactorMatrix()
        factors.setMumpsIcntl(14, self._policy.room)

    def solve(self, b: Floats) -> Floats:
        """Give x of A x = b, a vector."""
        x = np.zeros_like(b)
        assert self._ksp is not None
        right, left = (petsc_vector(values, self._ksp.comm) for values in (b, x))
        self._ksp.solve(right, left)
        right.destroy()
        left.destroy()
        return x

    def release(self):
        """Free the factors; PETSc's objects outlive Python's until they are destroyed."""
        if self._ksp is not None:
            self._ksp.destroy()
        self._ksp = None


class Mumps:
    """MUMPS' LDLᵀ; its count of negative pivots says whether the matrix is positive definite."""

    def __init__(self, matrix: PETSc.Mat, *, policy: LinearPolicy = POLICY.linear):
        self._matrix, self._factors = matrix, Factorisation(policy)

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; exact whatever `relative` is, and by the last factors as long as the values are theirs."""
        if not self._factors.factor(self._matrix, symmetric=True):
            return LinearAnswer(np.zeros_like(b), False, 1, "singular")
        negative = self._factors.negative
        return LinearAnswer(self._factors.solve(b), negative == 0, 1, f"{negative} negative pivots" if negative else "")


LINEAR_SOLVERS: dict[str, Callable[..., LinearSolver]] = {"cg": ConjugateGradients, "mumps": Mumps}


def petsc_vector(values: Floats, comm, size: int = 1) -> PETSc.Vec:
    """Give PETSc's vector of the values that this rank owns, in blocks."""
    return PETSc.Vec().createWithArray(values, bsize=size, comm=comm)


def solve_with(ksp: PETSc.KSP, b: Floats, size: int = 3) -> tuple[Floats, str]:
    """Give x, and why it is no solution (empty if it is).

    Every reason to stop is checked. A KSP that has failed stays so: its owner makes another.
    """
    free_dropped(ksp.comm)
    x = np.zeros_like(b)
    answer = petsc_vector(x, ksp.comm, size)
    try:
        ksp.solve(petsc_vector(b, ksp.comm, size), answer)
    except PETSc.Error as error:
        return x, f"PETSc error {error.ierr}"
    if ksp.reason > 0 and np.isfinite(answer.norm()):  # of all ranks that share it
        return x, ""
    names = {value: name for name, value in vars(PETSc.KSP.ConvergedReason).items() if isinstance(value, int)}
    return x, names.get(ksp.reason, str(ksp.reason))


def hold(matrix: PETSc.Mat, held: Ints, values: Floats, b: Floats):
    """Replace held dofs' equations (k,) by x = values (k,), in matrix and right-hand side, symmetrically.

    Each rank names those that it owns, counted from its first.
    """
    x = np.zeros_like(b)
    x[held] = values
    scale = matrix.getDiagonal().norm(PETSc.NormType.INFINITY) or 1.0
    rows = (matrix.getOwnershipRange()[0] + held).astype(PETSc.IntType)
    given, right = (petsc_vector(each, matrix.comm, matrix.getBlockSize()) for each in (x, b))
    matrix.zeroRowsColumns(rows, diag=scale, x=given, b=right)


def multiply(matrix: PETSc.Mat, x: Floats) -> Floats:
    """Multiply a matrix by a vector."""
    result = np.zeros(matrix.getLocalSize()[0])
    matrix.mult(*(petsc_vector(values, matrix.comm, matrix.getBlockSize()) for values in (x, result)))
    return result
