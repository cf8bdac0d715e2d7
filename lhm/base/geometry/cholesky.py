"""Sparse Cholesky factors by one of three libraries, and which of them are there.

| name     | library                           | licence                    | float32 | reuses a pattern |
|----------|-----------------------------------|----------------------------|---------|------------------|
| cholespy | PyPI's cholespy                   | BSD-3; in it CHOLMOD       | yes     | no               |
| cholmod  | the system's CHOLMOD, by sksparse | LGPL-2.1, supernodes GPL-2 | no      | yes              |
| superlu  | SciPy's SuperLU                   | BSD-3                      | yes     | no               |

The PD matrix of a head whose skin bends (12 342 unknowns, 1.7 million entries in the factor) took a core with busy
neighbours 207 ms by cholespy, 184 by SuperLU and 65 by CHOLMOD, after one analysis of 92 ms; a solve of three columns
3.0, 6.6 and 3.9 ms. Nested dissection halves the work of the order that CHOLMOD takes by itself.
CHOLMOD: Chen, Davis, Hager and Rajamanickam 2008, Algorithm 887.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from cholespy import CholeskySolverD, CholeskySolverF, MatrixType
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from ..checks import one_of
from ..errors import MissingDependencyError

try:
    from sksparse.cholmod import CholmodNotPositiveDefiniteError, analyze
except ImportError:
    analyze = None

LinearSolver = Literal["cholespy", "cholmod", "superlu"]
Solve = Callable[[NDArray], NDArray]

WIDEST = 12
"""Columns of one solve. cholespy 2.2 never frees the workspace of a factor's widest solve, 6 MB for a head's shapes. A
multiple of CHOLMOD's four columns, so that answers are the same to the bit."""
KEPT = 6
"""Analyses that a process keeps, one megabyte of a head's PD matrix and twenty of a Hessian."""


def factorise(matrix: csc_matrix, *, linear_solver: LinearSolver | None = None) -> Solve:
    """Factor a symmetric positive definite matrix (n, n); the result maps (n, columns) of its dtype to solutions.

    linear_solver None takes cholespy. Raises InputError for an unknown linear solver and MissingDependencyError for
    CHOLMOD where it is not installed.
    """
    if linear_solver is not None:
        one_of("linear solver", linear_solver, get_args(LinearSolver))
    if linear_solver == "cholmod":
        if not has_cholmod():
            raise MissingDependencyError("linear solver 'cholmod' needs scikit-sparse: pip install 'softdeca[cholmod]'")
        return CholmodFactor(matrix, find_analysis(matrix))
    if linear_solver == "superlu":
        return SuperluFactor(matrix)
    return CholespyFactor(matrix)


def factorise_definite(matrix: csc_matrix, *, linear_solver: LinearSolver | None = None) -> Solve:
    """Factor a matrix; raise LinAlgError if it is not positive definite.

    linear_solver None takes CHOLMOD where it is installed, which analyses a pattern once, else what `factorise` takes;
    errors are as there.
    """
    if has_cholmod() and linear_solver is None:
        linear_solver = "cholmod"
    if linear_solver == "superlu":
        # LU without pivoting meets the signs of LDLᵀ.
        factor = SuperluFactor(matrix)
        if not (factor.lu.U.diagonal() > 0.0).all():
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        return factor
    try:
        return factorise(matrix, linear_solver=linear_solver)
    except ValueError:
        raise np.linalg.LinAlgError("the matrix is not positive definite") from None


def has_cholmod() -> bool:
    """Return whether the system's CHOLMOD can be called."""
    return analyze is not None


class CholespyFactor:
    """A factor by cholespy, of the matrix's dtype; calling it solves for right-hand sides. A copy is factored anew."""

    def __init__(self, matrix: csc_matrix):
        kind = CholeskySolverF if matrix.dtype == np.float32 else CholeskySolverD
        if not matrix.has_sorted_indices:
            matrix = matrix.sorted_indices()  # of others it solves another system, without a word
        self._matrix = matrix
        indptr, indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
        data = matrix.data.copy()  # cholespy 2.2 aborts on memory that is not numpy's own, as an unpickled array's
        self._solver = kind(matrix.shape[0], indptr, indices, data, MatrixType.CSC)

    def __reduce__(self):
        return CholespyFactor, (self._matrix,)

    def __call__(self, right: NDArray) -> NDArray:
        """Return the solutions, shape (n,) or (n, columns)."""
        if right.ndim == 2 and right.shape[1] > WIDEST:
            return np.hstack([self(right[:, k : k + WIDEST]) for k in range(0, right.shape[1], WIDEST)])
        right = np.ascontiguousarray(right)
        solution = np.zeros_like(right)
        self._solver.solve(right, solution)
        return solution


class SuperluFactor:
    """A factor by SuperLU; calling it solves for right-hand sides (n, columns). A copy is factored anew."""

    def __init__(self, matrix: csc_matrix):
        self._matrix = matrix
        options = {"SymmetricMode": True}
        self.lu: Any = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

    def __reduce__(self):
        return SuperluFactor, (self._matrix,)

    def __call__(self, right: NDArray) -> NDArray:
        """Return the solutions, shape (n,) or (n, columns)."""
        return self.lu.solve(right)


class CholmodAnalysis:
    """The order of elimination and the supernodes of the factors LLᵀ of all matrices of one pattern."""

    def __init__(self, matrix: csc_matrix):
        self.indptr, self.indices = matrix.indptr.copy(), matrix.indices.copy()
        self.symbolic = analyze(matrix, mode="supernodal", ordering_method="nesdis")

    def fits(self, matrix: csc_matrix) -> bool:
        """Return whether a matrix has the analysed pattern."""
        return np.array_equal(matrix.indptr, self.indptr) and np.array_equal(matrix.indices, self.indices)


_latest: list[CholmodAnalysis] = []
"""The KEPT analyses that were asked for last, the latest first."""


def find_analysis(matrix: csc_matrix) -> CholmodAnalysis:
    """Return the analysis of a matrix: one of the latest, where it fits."""
    analysis = next((each for each in _latest if each.fits(matrix)), None) or CholmodAnalysis(matrix)
    _latest[:] = [analysis, *(other for other in _latest if other is not analysis)][:KEPT]
    return analysis


class CholmodFactor:
    """A numeric factor, float64; calling it solves for right-hand sides (n, columns).

    The analysis is of a matrix of the same pattern, by default made anew. Raises LinAlgError for a matrix that is not
    positive definite. A copy is factored anew.
    """

    def __init__(self, matrix: csc_matrix, analysis: CholmodAnalysis | None = None):
        self.analysis = CholmodAnalysis(matrix) if analysis is None else analysis
        self._matrix = matrix
        try:
            self._factor = self.analysis.symbolic.cholesky(matrix.astype(np.float64, copy=False))
        except CholmodNotPositiveDefiniteError:
            raise np.linalg.LinAlgError("the matrix is not positive definite") from None

    def __reduce__(self):
        return CholmodFactor, (self._matrix,)

    def __call__(self, right: NDArray) -> NDArray:
        """Return the solutions (n, columns)."""
        return np.ascontiguousarray(self._factor(np.asarray(right, dtype=np.float64)))
