"""Sparse Cholesky factors in float32 or float64: cholespy's, or SuperLU's where cholespy is not installed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

try:
    from cholespy import CholeskySolverD, CholeskySolverF, MatrixType
except ImportError:
    CholeskySolverD = None


def factorise(matrix: csc_matrix) -> Callable[[NDArray], NDArray]:
    """Factor a symmetric positive definite matrix (n, n); the result maps (n, columns) of its dtype to solutions."""
    if CholeskySolverD is None:
        lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return lu.solve
    kind = CholeskySolverF if matrix.dtype == np.float32 else CholeskySolverD
    indptr, indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
    solver = kind(matrix.shape[0], indptr, indices, matrix.data, MatrixType.CSC)

    def solve(right: NDArray) -> NDArray:
        solution = np.zeros_like(right)
        solver.solve(right, solution)
        return solution

    return solve
