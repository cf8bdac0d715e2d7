"""Sparse Cholesky factors by one of three libraries, and which of them are there.

| name     | library              | licence                      | float32 | reuses a pattern |
|----------|----------------------|------------------------------|---------|------------------|
| cholespy | PyPI's cholespy      | BSD-3; in it CHOLMOD         | yes     | no               |
| cholmod  | the system's CHOLMOD | LGPL-2.1, supernodes GPL-2   | no      | yes              |
| superlu  | SciPy's SuperLU      | BSD-3                        | yes     | no               |

For a head (12 140 unknowns, 1.2 million entries in the factor) on one core: analysis and numeric factor 118 ms by
cholespy, 38 ms by CHOLMOD, of which 26 ms are the numeric part; a solve of three columns 2.4, 4.3 and 8 ms.

CHOLMOD (Chen, Davis, Hager and Rajamanickam 2008, Algorithm 887) is called by ctypes where the system has
libcholmod.so.3; it is loaded, not linked or shipped; Debian has it as libcholmod3. Of its structs only the matrices'
are spelled out, whose layout versions 3 and 4 share.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from ctypes import POINTER, byref, c_int, c_size_t, c_void_p
from functools import cache
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from ..errors import InputError, MissingDependencyError

try:
    from cholespy import CholeskySolverD, CholeskySolverF, MatrixType
except ImportError:
    CholeskySolverD = None

LinearSolver = Literal["cholespy", "cholmod", "superlu"]
Solve = Callable[[NDArray], NDArray]
Like: TypeAlias = "Solve | CholmodFactor | CholmodAnalysis | None"


def factorise(matrix: csc_matrix, *, linear_solver: LinearSolver | None = None, like: Like = None) -> Solve:
    """Factor a symmetric positive definite matrix (n, n); the result maps (n, columns) of its dtype to solutions.

    linear_solver None takes cholespy, or SuperLU where that is not installed. With "cholmod", `like` is a factor of a
    matrix of the same pattern, or its analysis, which is used again; others have no use for it. Raises InputError for
    an unknown linear solver and MissingDependencyError for one that is not installed.
    """
    if linear_solver not in (None, *get_args(LinearSolver)):
        raise InputError(f"unknown linear solver {linear_solver!r}; there are {', '.join(get_args(LinearSolver))}")
    if linear_solver == "cholmod":
        if cholmod_library() is None:
            raise MissingDependencyError("linear solver 'cholmod' needs libcholmod.so.3 (Debian's libcholmod3)")
        return CholmodFactor(matrix, _known(like))
    if linear_solver == "cholespy" and CholeskySolverD is None:
        raise MissingDependencyError("linear solver 'cholespy' needs the package cholespy")
    return _superlu(matrix) if linear_solver == "superlu" or CholeskySolverD is None else _cholespy(matrix)


def _known(like: Like) -> CholmodFactor | CholmodAnalysis | None:
    return like if isinstance(like, (CholmodFactor, CholmodAnalysis)) else None


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
    if linear_solver is None and cholmod_library() is not None:
        linear_solver = "cholmod"
    if linear_solver == "cholmod" and cholmod_library() is not None:
        return CholmodFactor(matrix, _known(like), definite=True)
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


COMMON_BYTES = 16384  # cholmod_common has 2664 in version 3.0
REAL, LOWER, SOLVE_A = 1, -1, 0
AUTO, SUPERNODAL = 1, 2
# Where cholmod_common has supernodal and print, and what both begin as: no message is wanted of what is raised.
SUPERNODAL_AT, PRINT_AT, PRINTED = 48, 144, 3


class _Sparse(ctypes.Structure):
    _fields_ = [
        *((name, c_size_t) for name in ("nrow", "ncol", "nzmax")),
        *((name, c_void_p) for name in ("p", "i", "nz", "x", "z")),
        *((name, c_int) for name in ("stype", "itype", "xtype", "dtype", "sorted", "packed")),
    ]


class _Dense(ctypes.Structure):
    _fields_ = [
        *((name, c_size_t) for name in ("nrow", "ncol", "nzmax", "d")),
        *((name, c_void_p) for name in ("x", "z")),
        *((name, c_int) for name in ("xtype", "dtype")),
    ]


@cache
def cholmod_library() -> ctypes.CDLL | None:
    """The shared library, or None where there is none."""
    try:
        found = ctypes.CDLL("libcholmod.so.3")
    except OSError:
        return None
    for name in ("analyze", "copy_factor"):
        getattr(found, f"cholmod_{name}").restype = c_void_p
    return found


class CholmodAnalysis:
    """The order of elimination and the structure of the factor for all matrices of one pattern.

    With `definite` the factor is LLᵀ by supernodes, which a matrix that is not positive definite does not have; else
    CHOLMOD may take LDLᵀ, which can be had of some that are indefinite.
    """

    def __init__(self, matrix: csc_matrix, *, definite: bool = False):
        loaded = cholmod_library()
        if loaded is None:
            raise OSError("libcholmod.so.3 is not installed")
        self.library = loaded
        self.indptr, self.indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
        self.common = ctypes.create_string_buffer(COMMON_BYTES)
        self.library.cholmod_start(self.common)
        _settle(self.common, definite)
        self.symbolic = c_void_p(self.library.cholmod_analyze(byref(self.sparse(matrix.data)), self.common))
        if not self.symbolic:
            raise MemoryError("CHOLMOD could not analyse the matrix")
        weakref.finalize(self, _release, self.library, self.symbolic, self.common, last=True)

    def fits(self, matrix: csc_matrix) -> bool:
        """Whether a matrix has the analysed pattern."""
        return np.array_equal(matrix.indptr, self.indptr) and np.array_equal(matrix.indices, self.indices)

    def sparse(self, data: NDArray) -> _Sparse:
        """The lower half of the matrix of this pattern and these entries, float64, which must outlive it."""
        n = len(self.indptr) - 1
        return _Sparse(
            *(n, n, len(self.indices)),
            *(self.indptr.ctypes.data, self.indices.ctypes.data, None, data.ctypes.data, None),
            *(LOWER, 0, REAL, 0, 1, 1),
        )


class CholmodFactor:
    """A numeric factor, float64; calling it solves.

    Raises LinAlgError for a matrix of which there is none: with `definite`, for each that is not positive definite.
    """

    def __init__(
        self, matrix: csc_matrix, like: CholmodFactor | CholmodAnalysis | None = None, *, definite: bool = False
    ):
        known = like.analysis if isinstance(like, CholmodFactor) else like
        fits = known is not None and known.fits(matrix)
        self.analysis: CholmodAnalysis = (
            known if known is not None and fits else CholmodAnalysis(matrix, definite=definite)
        )
        calls, common = self.analysis.library, self.analysis.common
        self._factor = c_void_p(calls.cholmod_copy_factor(self.analysis.symbolic, common))
        if not self._factor:
            raise MemoryError("CHOLMOD could not allocate a factor")
        self._kept = [POINTER(_Dense)() for _ in range(3)]  # solution and two workspaces, used again
        weakref.finalize(self, _release, calls, self._factor, common, self._kept, owner=self.analysis)
        data = np.ascontiguousarray(matrix.data, dtype=np.float64)
        done = calls.cholmod_factorize(byref(self.analysis.sparse(data)), self._factor, common)
        n, minor = ctypes.cast(self._factor, POINTER(c_size_t * 2)).contents
        if not done or minor < n:
            raise np.linalg.LinAlgError("the matrix is not positive definite")

    def __call__(self, right: NDArray) -> NDArray:
        """The solutions for right-hand sides (n, columns)."""
        columns = np.asfortranarray(right, dtype=np.float64)
        n, count = columns.shape
        given = _Dense(n, count, n * count, n, columns.ctypes.data, None, REAL, 0)
        solution, *work = (byref(kept) for kept in self._kept)
        calls = self.analysis.library
        if not calls.cholmod_solve2(
            SOLVE_A, self._factor, byref(given), None, solution, None, *work, self.analysis.common
        ):
            raise MemoryError("CHOLMOD could not solve")
        values = ctypes.cast(self._kept[0].contents.x, POINTER(ctypes.c_double))
        return np.array(np.ctypeslib.as_array(values, (count, n)).T, order="C")


def _settle(common: ctypes.Array, definite: bool):
    supernodal, printed = (c_int.from_buffer(common, at) for at in (SUPERNODAL_AT, PRINT_AT))
    if supernodal.value != AUTO or printed.value != PRINTED:
        raise OSError("this libcholmod has its settings elsewhere than version 3")
    supernodal.value, printed.value = SUPERNODAL if definite else AUTO, 0


def _release(calls, factor, common, kept=(), *, owner=None, last: bool = False):
    """Free a factor and its workspaces; `owner` keeps the analysis alive until then, `last` closes the library."""
    for dense in kept:
        calls.cholmod_free_dense(byref(dense), common)
    calls.cholmod_free_factor(byref(factor), common)
    if last:
        calls.cholmod_finish(common)
