"""Linear solvers for a symmetric matrix with held components: conjugate gradients with algebraic multigrid, and MUMPS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...lhm.errors import SceneError
from ...lhm.mesh import Floats, Ints
from .dolfinx_version import COMM, PETSc

# The default estimate of the smoother's eigenvalues is too low at large strain: it turns the preconditioner indefinite,
# and Newton stalls without a word.
_MULTIGRID = {
    "pc_gamg_threshold": 0.01,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
    "mg_levels_esteig_ksp_max_it": 30,
    "mg_levels_ksp_chebyshev_esteig": "0,0.1,0,1.2",
}
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
        """x with a residual below `relative` times b's norm, if A is positive definite."""
        ...


def _vector(values: Floats) -> PETSc.Vec:
    return PETSc.Vec().createWithArray(values, bsize=3, comm=COMM)


def _reason(ksp: PETSc.KSP) -> str:
    names = {value: name for name, value in vars(PETSc.KSP.ConvergedReason).items() if isinstance(value, int)}
    return names.get(ksp.reason, str(ksp.reason))


class ConjugateGradients:
    """CG with GAMG; the aggregates come from the matrix' near-null space of rigid motions."""

    def __init__(self, matrix: PETSc.Mat):
        options = PETSc.Options()
        prefix = "softdeca_cg_"
        for key, value in _MULTIGRID.items():
            options[prefix + key] = value
        self._ksp = PETSc.KSP().create(COMM)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setType(PETSc.KSP.Type.CG)
        self._ksp.setOperators(matrix)
        self._ksp.getPC().setType(PETSc.PC.Type.GAMG)
        self._ksp.setFromOptions()

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; a direction of negative curvature counts as not found."""
        x = np.zeros_like(b)
        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=MAX_LINEAR_ITERATIONS)
        try:
            self._ksp.solve(_vector(b), _vector(x))
        except PETSc.Error as error:
            return LinearAnswer(x, False, 0, f"PETSc error {error.ierr}")
        found = self._ksp.reason > 0 and bool(np.isfinite(x).all())
        return LinearAnswer(x, found, self._ksp.its, "" if found else _reason(self._ksp))


class Mumps:
    """MUMPS' LDLᵀ; its count of negative pivots says whether the matrix is positive definite."""

    def __init__(self, matrix: PETSc.Mat):
        self._ksp = PETSc.KSP().create(COMM)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.setOperators(matrix)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType("mumps")

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; exact whatever `relative` is."""
        x = np.zeros_like(b)
        try:
            self._ksp.solve(_vector(b), _vector(x))
        except PETSc.Error as error:
            return LinearAnswer(x, False, 1, f"PETSc error {error.ierr}")
        if self._ksp.reason <= 0 or not np.isfinite(x).all():
            return LinearAnswer(x, False, 1, _reason(self._ksp))
        negative = self._ksp.getPC().getFactorMatrix().getMumpsInfog(12)
        return LinearAnswer(x, negative == 0, 1, f"{negative} negative pivots" if negative else "")


LINEAR_SOLVERS = {"cg": ConjugateGradients, "mumps": Mumps}


def linear_solver(name: str, matrix: PETSc.Mat) -> LinearSolver:
    """One of LINEAR_SOLVERS by name; SceneError for another."""
    if name not in LINEAR_SOLVERS:
        raise SceneError(f"solver 'fenicsx': unknown linear_solver {name!r}; there are {', '.join(LINEAR_SOLVERS)}")
    return LINEAR_SOLVERS[name](matrix)


def hold(matrix: PETSc.Mat, held: Ints, values: Floats, b: Floats):
    """Replace the equations of held dofs (k,) by x = values (k,), in matrix and right-hand side (3n,), symmetrically."""
    x = np.zeros_like(b)
    x[held] = values
    scale = matrix.getDiagonal().norm(PETSc.NormType.INFINITY) or 1.0
    rows = held.astype(PETSc.IntType)
    matrix.zeroRowsColumns(rows, diag=scale, x=_vector(x), b=_vector(b))
