"""Linear solvers for a symmetric matrix with held dofs: conjugate gradients with algebraic multigrid, and MUMPS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...lhm.mesh import Floats, Ints
from .dolfinx_version import COMM, PETSc

# The default estimate of the smoother's eigenvalues is too low at large strain: it turns the preconditioner indefinite,
# and Newton stalls without a word.
_MULTIGRID = {
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
    "mg_levels_esteig_ksp_max_it": 30,
    "mg_levels_ksp_chebyshev_esteig": "0,0.1,0,1.2",
}
_PREFIX = "softdeca_cg_"
MAX_LINEAR_ITERATIONS = 1000


@dataclass(frozen=True, eq=False)
class LinearAnswer:
    """x (3n,), whether it was found, the iterations it took, and a word on why not."""

    x: Floats
    found: bool
    iterations: int
    why: str = ""


class LinearSolver(Protocol):
    """Solves A x = b with the present values of the matrix that it was made for."""

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """Give x with a residual below `relative` times b's norm, if A is positive definite."""
        ...


def _vector(values: Floats, comm=COMM) -> PETSc.Vec:
    return PETSc.Vec().createWithArray(values, bsize=3, comm=comm)


class ConjugateGradients:
    """CG with GAMG; the aggregates come from the matrix' near-null space of rigid motions."""

    def __init__(self, matrix: PETSc.Mat):
        self._matrix = matrix
        options = PETSc.Options()
        for key, value in _MULTIGRID.items():
            options[_PREFIX + key] = value
        self._ksp = self._create()

    def _create(self) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self._matrix.comm)
        ksp.setOptionsPrefix(_PREFIX)
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.setOperators(self._matrix)
        ksp.getPC().setType(PETSc.PC.Type.GAMG)
        ksp.setFromOptions()
        return ksp

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; a direction of negative curvature counts as not found."""
        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=MAX_LINEAR_ITERATIONS)
        x, why = _solve(self._ksp, b)
        iterations = self._ksp.its
        if why:
            self._ksp = self._create()
        return LinearAnswer(x, not why, iterations, why)


class Mumps:
    """MUMPS' LDLᵀ; its count of negative pivots says whether the matrix is positive definite."""

    def __init__(self, matrix: PETSc.Mat):
        self._matrix = matrix
        self._ksp = self._create()

    def _create(self) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self._matrix.comm)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.setOperators(self._matrix)
        ksp.getPC().setType(PETSc.PC.Type.CHOLESKY)
        ksp.getPC().setFactorSolverType("mumps")
        return ksp

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; exact whatever `relative` is."""
        x, why = _solve(self._ksp, b)
        if why:
            self._ksp = self._create()
            return LinearAnswer(x, False, 1, why)
        negative = self._ksp.getPC().getFactorMatrix().getMumpsInfog(12)
        return LinearAnswer(x, negative == 0, 1, f"{negative} negative pivots" if negative else "")


def _solve(ksp: PETSc.KSP, b: Floats) -> tuple[Floats, str]:
    """x, and why it is no solution (empty if it is). A KSP that has failed stays so: its owner makes another."""
    x = np.zeros_like(b)
    found = _vector(x, ksp.comm)
    try:
        ksp.solve(_vector(b, ksp.comm), found)
    except PETSc.Error as error:
        return x, f"PETSc error {error.ierr}"
    if ksp.reason > 0 and np.isfinite(found.norm()):  # of all processes that share it
        return x, ""
    names = {value: name for name, value in vars(PETSc.KSP.ConvergedReason).items() if isinstance(value, int)}
    return x, names.get(ksp.reason, str(ksp.reason))


LINEAR_SOLVERS: dict[str, Callable[[PETSc.Mat], LinearSolver]] = {"cg": ConjugateGradients, "mumps": Mumps}


def hold(matrix: PETSc.Mat, held: Ints, values: Floats, b: Floats):
    """Replace held dofs' equations (k,) by x = values (k,), in matrix and right-hand side (3n,), symmetrically."""
    x = np.zeros_like(b)
    x[held] = values
    scale = matrix.getDiagonal().norm(PETSc.NormType.INFINITY) or 1.0
    rows = held.astype(PETSc.IntType)
    matrix.zeroRowsColumns(rows, diag=scale, x=_vector(x), b=_vector(b))
