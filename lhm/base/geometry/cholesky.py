"""Sparse Cholesky factors by one of three libraries, and which of them are there.

| name     | library                           | licence                    | float32 | reuses a pattern |
|----------|-----------------------------------|----------------------------|---------|------------------|
| cholespy | PyPI's cholespy                   | BSD-3; in it CHOLMOD       | yes     | no               |
| cholmod  | the system's CHOLMOD, by sksparse | LGPL-2.1, supernodes GPL-2 | no      | yes              |
| superlu  | SciPy's SuperLU                   | BSD-3                      | yes     | no               |

For a head (12 140 unknowns, 1.2 million entries in the factor) on one core: analysis and numeric factor 118 ms by
cholespy, 38 ms by CHOLMOD, of which 26 ms are the numeric part; a solve of three columns 2.4, 4.3 and 8 ms.
CHOLMOD: Chen, Davis, Hager and Rajamanickam 2008, Algorithm 887.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, TypeAlias, get_args

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
Like: TypeAlias = "Solve | CholmodAnalysis | None"


WIDEST = 12
"""Columns of one solve. cholespy 2.2 never frees the workspace of a factor's widest solve, 6 MB for a head's shapes. A
multiple of CHOLMOD's four columns, so that answers are the same to the bit."""


def factorise(matrix: csc_matrix, *, linear_solver: LinearSolver | None = None, like: Like = None) -> Solve:
    """Factor a symmetric positive definite matrix (n, n); the result maps (n, columns) of its dtype to solutions.

    linear_solver None takes cholespy. With "cholmod", `like` is a factor of a
    matrix of the same pattern, or its analysis, which is used again; others have no use for it. Raises InputError for
    an unknown linear solver and MissingDependencyError for CHOLMOD where it is not installed.
    """
    if linear_solver is not None:
        one_of("linear solver", linear_solver, get_args(LinearSolver))
    if linear_solver == "cholmod":
        if not has_cholmod():
            raise MissingDependencyError("linear solver 'cholmod' needs scikit-sparse: pip install 'softdeca[cholmod]'")
        return CholmodFactor(matrix, like)
    if linear_solver == "superlu":
        return SuperluFactor(matrix)
    return CholespyFactor(matrix)


def factorise_definite(matrix: csc_matrix, *, linear_solver: LinearSolver | None = None, like: Like = None) -> Solve:
    """Factor a matrix; raise LinAlgError if it is not positive definite.

    linear_solver None takes CHOLMOD by supernodes where it is installed, which is what factors of three unknowns per
    vertex need most, else what `factorise` takes; `like` and errors are as there.
    """
    if has_cholmod() and linear_solver in (None, "cholmod"):
        return CholmodFactor(matrix, like, definite=True)
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
    """The order of elimination and the structure of the factor for all matrices of one pattern.

    With `definite` the factor is LLᵀ by supernodes, which a matrix that is not positive definite does not have; else
    CHOLMOD may take LDLᵀ, which can be had of some that are indefinite.
    """

    def __init__(self, matrix: csc_matrix, *, definite: bool = False):
        self.indptr, self.indices = matrix.indptr.copy(), matrix.indices.copy()
        self.definite = definite
        self.symbolic = analyze(matrix, mode="supernodal" if definite else "auto")

    def fits(self, matrix: csc_matrix) -> bool:
        """Return whether a matrix has the analysed pattern."""
        return np.array_equal(matrix.indptr, self.indptr) and np.array_equal(matrix.indices, self.indices)


class CholmodFactor:
    """A numeric factor, float64; calling it solves for right-hand sides (n, columns).

    `like` is a factor or an analysis, used again if the pattern is the same. Raises LinAlgError for a matrix of which
    there is no factor: with `definite`, for each that is not positive definite. A copy is factored anew.
    """

    def __init__(self, matrix: csc_matrix, like: Like = None, *, definite: bool = False):
        analysis = like.analysis if isinstance(like, CholmodFactor) else like
        if not isinstance(analysis, CholmodAnalysis) or not analysis.fits(matrix):
            analysis = CholmodAnalysis(matrix, definite=definite)
        self.analysis: CholmodAnalysis = analysis
        self._matrix = matrix
        try:
            self._factor = analysis.symbolic.cholesky(matrix.astype(np.float64, copy=False))
        except CholmodNotPositiveDefiniteError:
            raise np.linalg.LinAlgError("the matrix is not positive definite") from None

    def __reduce__(self):
        return partial(CholmodFactor, definite=self.analysis.definite), (self._matrix,)

    def __call__(self, right: NDArray) -> NDArray:
        """Return the solutions (n, columns)."""
        return np.ascontiguousarray(self._factor(np.asarray(right, dtype=np.float64)))
