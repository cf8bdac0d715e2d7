"""A direct solver for symmetric positive definite matrices that says when a matrix is not definite."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csc_matrix, identity
from scipy.sparse.linalg import splu

from ...lhm.base.geometry import cholesky
from ...lhm.base.mesh import Floats

SHIFTS = (0.0, 1e-10, 1e-7, 1e-4, 1e-1)


def solve_definite(matrix: csc_matrix, right: Floats) -> Floats | None:
    """The solution, shape (size,), or None if the matrix is not positive definite to working precision.

    By CHOLMOD where the system has it, else by SuperLU: without pivoting, LU of a symmetric matrix is LDLᵀ, and the
    signs of D count the negative eigenvalues (Sylvester).
    """
    solve = _superlu(matrix) if cholesky.cholmod_library() is None else _cholmod(matrix)
    if solve is None:
        return None
    solution = solve(right)
    solution += solve(right - matrix @ solution)
    return solution if np.isfinite(solution).all() else None


def _cholmod(matrix: csc_matrix) -> Callable[[Floats], Floats] | None:
    try:
        factor = cholesky.CholmodFactor(matrix, definite=True)
    except np.linalg.LinAlgError:
        return None
    return lambda right: factor(right[:, None])[:, 0]


def _superlu(matrix: csc_matrix) -> Callable[[Floats], Floats] | None:
    options = {"SymmetricMode": True, "Equil": False}
    try:
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError:
        return None
    if not np.array_equal(factors.perm_r, factors.perm_c) or factors.U.diagonal().min() <= 0:
        return None
    return factors.solve


def solve_semidefinite(matrix: csc_matrix, right: Floats, *, scale: float) -> Floats | None:
    """For a semidefinite matrix: as little of `scale` is added to the diagonal as makes it definite; None as above."""
    for shift in SHIFTS:
        solution = solve_definite(matrix + shift * scale * identity(matrix.shape[0], format="csc"), right)
        if solution is not None:
            return solution
    return None
