"""Linear solvers for a symmetric matrix with held dofs: conjugate gradients with algebraic multigrid, and MUMPS.

MUMPS' factors also say how many directions lose stiffness: by LDLᵀ, or by LU where a matrix is not symmetric.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from .dolfinx_version import PETSc, free_dropped

# The default estimate of the smoother's eigenvalues is too low at large strain: it turns the preconditioner indefinite,
# and Newton stalls without a word.
MULTIGRID = {
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
    "mg_levels_esteig_ksp_max_it": 30,
    "mg_levels_ksp_chebyshev_esteig": "0,0.1,0,1.2",
}
_PREFIX = "softdeca_cg_"
MAX_LINEAR_ITERATIONS = 1000
SETUP = 16  # iterations
ASYMMETRY = 1e-9  # of a matrix' norm, below which it counts as symmetric
ROOM = 60  # percent beyond the estimate: saddle points delay pivots
INDEFINITE = ("DIVERGED_INDEFINITE_MAT", "DIVERGED_INDEFINITE_PC")  # CG blames either for a matrix that is


@dataclass(frozen=True, eq=False)
class LinearAnswer:
    """x, a vector, whether it was found, the iterations it took, and a word on why not."""

    x: Floats
    found: bool
    iterations: int
    why: str = ""


class LinearSolver(Protocol):
    """Solves A x = b with the present values of the matrix that it was made for, by all processes that share it."""

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """Give x with a residual below `relative` times b's norm, if A is positive definite."""
        ...


def vector(values: Floats, comm, size: int = 1) -> PETSc.Vec:
    """PETSc's vector of the values that this process owns, in blocks."""
    return PETSc.Vec().createWithArray(values, bsize=size, comm=comm)


def set_options(prefix: str, values: Mapping[str, object]):
    """Put options into PETSc's database; each counts as used, for at its end PETSc warns of what it had no need of."""
    options = PETSc.Options()
    for key, value in values.items():
        options[prefix + key] = value
        options.hasName(prefix + key)


class ConjugateGradients:
    """CG with GAMG; the aggregates come from the matrix' near-null space of rigid motions.

    A set-up of GAMG costs as much as SETUP iterations. It is kept while the matrix' values change, until it has cost
    that much in iterations beyond those that it took when it was new.
    """

    def __init__(self, matrix: PETSc.Mat):
        self._matrix = matrix
        set_options(_PREFIX, MULTIGRID)
        self._begin_anew()

    def _begin_anew(self):
        self._ksp = PETSc.KSP().create(self._matrix.comm)
        self._ksp.setOptionsPrefix(_PREFIX)
        self._ksp.setType(PETSc.KSP.Type.CG)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._ksp.setOperators(self._matrix)
        self._ksp.getPC().setType(PETSc.PC.Type.GAMG)
        self._ksp.setFromOptions()
        self._worn_out()

    def _worn_out(self):
        """Have GAMG set up anew at the next solve."""
        self._per_decade, self._wear, self._doubtful = 0.0, 0.0, False

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; a direction of negative curvature counts as not found."""
        before = 0
        if self._per_decade:
            answer = self._kept(b, relative)
            if answer.found or self._per_decade:
                return answer
            before = answer.iterations
        answer = self._new(b, relative)
        return replace(answer, iterations=before + answer.iterations)

    def _kept(self, b: Floats, relative: float) -> LinearAnswer:
        """Solve by the last set-up; not much longer than another one would take."""
        expected = self._per_decade * -np.log10(relative)
        answer = self._tried(b, relative, int(expected + 2 * SETUP))
        if answer.why in INDEFINITE and not self._doubtful:
            self._doubtful = True  # twice in a row, and the set-up is to blame
            return answer
        self._doubtful = False
        self._wear = max(self._wear + answer.iterations - expected, 0.0)
        if self._wear > SETUP or not answer.found:
            self._worn_out()
        return answer

    def _new(self, b: Floats, relative: float) -> LinearAnswer:
        self._ksp.getPC().setReusePreconditioner(False)
        answer = self._tried(b, relative, MAX_LINEAR_ITERATIONS)
        if not answer.found:
            self._begin_anew()  # GAMG does not recover from values that were indefinite, or that it failed for
            return answer
        self._ksp.getPC().setReusePreconditioner(True)
        self._per_decade = max(answer.iterations, 1) / -np.log10(relative)
        return answer

    def _tried(self, b: Floats, relative: float, limit: int) -> LinearAnswer:
        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=limit)
        x, why = solved(self._ksp, b)
        return LinearAnswer(x, not why, self._ksp.its, why)


class Factorisation:
    """Factors a matrix, always the same one, whenever its values have changed; the elimination's order is kept.

    `solve` uses the last factors. After `factor`, `negative` is the number of negative pivots of a symmetric matrix, or
    of another one 0 or 1 by the sign of its determinant.
    """

    def __init__(self):
        self._ksp: PETSc.KSP | None = None
        self.negative = 0
        self.symmetric = True

    def factor(self, matrix: PETSc.Mat, *, symmetric: bool) -> bool:
        """Factor a matrix that processes share; give whether it is regular.

        If it need not be `symmetric`, it is looked whether it is.
        """
        size = matrix.norm(PETSc.NormType.FROBENIUS)
        if not np.isfinite(size):
            return False
        if not symmetric:
            away = matrix.transpose(PETSc.Mat())
            away.axpy(-1.0, matrix)
            symmetric = away.norm(PETSc.NormType.FROBENIUS) <= ASYMMETRY * size
            away.destroy()
        # Of several processes MUMPS gives the determinant's sign for the first factors alone.
        again = symmetric or matrix.comm.size == 1
        if self._ksp is None or symmetric != self.symmetric or not again:
            self.release()
            self._begin(matrix, symmetric)
        return self._numeric(matrix)

    def _begin(self, matrix: PETSc.Mat, symmetric: bool):
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
        factors.setMumpsIcntl(14, ROOM)
        if not symmetric:
            factors.setMumpsIcntl(33, 1)

    def _numeric(self, matrix: PETSc.Mat) -> bool:
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
        self.negative = factors.getMumpsInfog(12) if self.symmetric else int(factors.getMumpsRinfog(12) < 0)
        return True

    def solve(self, b: Floats) -> Floats:
        """Give x of A x = b, a vector."""
        x = np.zeros_like(b)
        assert self._ksp is not None
        right, left = (PETSc.Vec().createWithArray(values, comm=self._ksp.comm) for values in (b, x))
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

    def __init__(self, matrix: PETSc.Mat):
        self._matrix, self._factors = matrix, Factorisation()

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; exact whatever `relative` is, and by the last factors as long as the values are theirs."""
        if not self._factors.factor(self._matrix, symmetric=True):
            return LinearAnswer(np.zeros_like(b), False, 1, "singular")
        negative = self._factors.negative
        return LinearAnswer(self._factors.solve(b), negative == 0, 1, f"{negative} negative pivots" if negative else "")


def solved(ksp: PETSc.KSP, b: Floats, size: int = 3) -> tuple[Floats, str]:
    """x, and why it is no solution (empty if it is). A KSP that has failed stays so: its owner makes another."""
    free_dropped(ksp.comm)
    x = np.zeros_like(b)
    found = vector(x, ksp.comm, size)
    try:
        ksp.solve(vector(b, ksp.comm, size), found)
    except PETSc.Error as error:
        return x, f"PETSc error {error.ierr}"
    return x, why_not(ksp, found)


def why_not(ksp: PETSc.KSP, x: PETSc.Vec) -> str:
    """Why x is no solution, by the solver's reason to stop; empty if it is."""
    if ksp.reason > 0 and np.isfinite(x.norm()):  # of all processes that share it
        return ""
    names = {value: name for name, value in vars(PETSc.KSP.ConvergedReason).items() if isinstance(value, int)}
    return names.get(ksp.reason, str(ksp.reason))


LINEAR_SOLVERS: dict[str, Callable[[PETSc.Mat], LinearSolver]] = {"cg": ConjugateGradients, "mumps": Mumps}


def hold(matrix: PETSc.Mat, held: Ints, values: Floats, b: Floats):
    """Replace held dofs' equations (k,) by x = values (k,), in matrix and right-hand side, symmetrically.

    Each process names those that it owns, counted from its first.
    """
    x = np.zeros_like(b)
    x[held] = values
    scale = matrix.getDiagonal().norm(PETSc.NormType.INFINITY) or 1.0
    rows = (matrix.getOwnershipRange()[0] + held).astype(PETSc.IntType)
    known, right = (vector(each, matrix.comm, matrix.getBlockSize()) for each in (x, b))
    matrix.zeroRowsColumns(rows, diag=scale, x=known, b=right)


def product(matrix: PETSc.Mat, x: Floats) -> Floats:
    """A matrix times a vector."""
    result = np.zeros(matrix.getLocalSize()[0])
    size = matrix.getBlockSize()
    matrix.mult(vector(x, matrix.comm, size), vector(result, matrix.comm, size))
    return result
