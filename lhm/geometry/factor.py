"""Sparse Cholesky factors by one of three libraries, and which of them are there.

| name     | library              | licence                      | float32 | reuses a pattern |
|----------|----------------------|------------------------------|---------|------------------|
| cholespy | PyPI's cholespy      | BSD-3; in it CHOLMOD         | yes     | no               |
| cholmod  | the system's CHOLMOD | LGPL-2.1, supernodes GPL-2   | no      | yes              |
| superlu  | SciPy's SuperLU      | BSD-3                        | yes     | no               |

For a head (12 140 unknowns, 1.2 million entries in the factor) on one core: analysis and numeric factor 118 ms by
cholespy, 38 ms by CHOLMOD, of which 26 ms are the numeric part; a solve of three columns 2.4, 4.3 and 8 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from ..errors import InputError, MissingDependencyError
from . import cholmod

try:
    from cholespy import CholeskySolverD, CholeskySolverF, MatrixType
except ImportError:
    CholeskySolverD = None

LinearSolver = Literal["cholespy", "cholmod", "superlu"]
Solve = Callable[[NDArray], NDArray]
Like: TypeAlias = Solve | cholmod.Analysis | None


def factorise(matrix: csc_matrix, *, linear_solver: LinearSolver | None = None, like: Like = None) -> Solve:
    """Factor a symmetric positive definite matrix (n, n); the result maps (n, columns) of its dtype to solutions.

    linear_solver None takes cholespy, or SuperLU where that is not installed. With "cholmod", `like` is a factor of a
    matrix of the same pattern, or its analysis, which is used again; others have no use for it. Raises InputError for
    an unknown linear solver and MissingDependencyError for one that is not installed.
    """
    if linear_solver not in (None, *get_args(LinearSolver)):
        raise InputError(f"unknown linear solver {linear_solver!r}; there are {', '.join(get_args(LinearSolver))}")
    if linear_solver == "cholmod":
        if cholmod.library() is None:
            raise MissingDependencyError("linear solver 'cholmod' needs libcholmod.so.3 (Debian's libcholmod3)")
        return cholmod.Factor(matrix, _known(like))
    if linear_solver == "cholespy" and CholeskySolverD is None:
        raise MissingDependencyError("linear solver 'cholespy' needs the package cholespy")
    return _superlu(matrix) if linear_solver == "superlu" or CholeskySolverD is None else _cholespy(matrix)


def _known(like: Like) -> cholmod.Factor | cholmod.Analysis | None:
    return like if isinstance(like, (cholmod.Factor, cholmod.Analysis)) else None


def _superlu(matrix: csc_matrix) -> Solve:
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return lu.solve


def _cholespy(matrix: csc_matrix) -> Solve:
    kind = CholeskySolverF if matrix.dtype == np.float32 else CholeskySolverD
    indptr, indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
    solver = kind(matrix.shape[0], indptr, indices, matrix.data, MatrixType.CSC)

    def solve(right: NDArray) -> NDArray:
        solution = np.zeros_like(right)
        solver.solve(right, solution)
        return solution

    return solve


def factorise_definite(matrix: csc_matrix, *, linear_solver: LinearSolver | None = None, like: Like = None) -> Solve:
    """Factor a matrix that may turn out not to be positive definite: then LinAlgError is raised.

    linear_solver None takes CHOLMOD by supernodes where the system has it, which is what factors of three unknowns per
    vertex need most, else what `factorise` takes; `like` and errors are as there.
    """
    if linear_solver is None and cholmod.library() is not None:
        linear_solver = "cholmod"
    if linear_solver == "cholmod" and cholmod.library() is not None:
        return cholmod.Factor(matrix, _known(like), definite=True)
    if linear_solver == "superlu" or (linear_solver is None and CholeskySolverD is None):
        # LU without pivoting meets the signs of LDLᵀ.
        lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        if not (lu.U.diagonal() > 0.0).all():
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        return lu.solve
    try:
        return factorise(matrix, linear_solver=linear_solver)
    except ValueError:
        raise np.linalg.LinAlgError("the matrix is not positive definite") from None
