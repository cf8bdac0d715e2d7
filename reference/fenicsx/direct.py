"""A direct factorisation that says how many directions lose stiffness: MUMPS' LDLᵀ, or its LU where not symmetric."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.mesh import Floats
from .dolfinx_version import ALONE, PETSc

ASYMMETRY = 1e-9  # of a matrix' norm, below which it counts as symmetric
ROOM = 60  # percent beyond the estimate: saddle points delay pivots


class Factorisation:
    """Factors matrices one after the other; the elimination's order is kept as long as the pattern is.

    `solve` uses the last one. After `factor`, `negative` is the number of negative pivots of a symmetric matrix, or of
    another one 0 or 1 by the sign of its determinant.
    """

    def __init__(self):
        self._ksp: PETSc.KSP | None = None
        self._matrix: PETSc.Mat | None = None
        self._pattern: csr_matrix | None = None
        self.negative = 0
        self.symmetric = True

    def factor(self, matrix: csr_matrix, *, symmetric: bool) -> bool:
        """Factor a matrix (n, n) of this process; give whether it is regular."""
        if not np.isfinite(matrix.data).all():
            return False
        if self._matrix is None or symmetric != self.symmetric or not self._has_pattern_of(matrix):
            self.release()
            self._pattern = matrix
            self._matrix = PETSc.Mat().createAIJ(matrix.shape, csr=csr_arrays(matrix), comm=ALONE)
            self._begin(self._matrix, symmetric)
        else:
            self._matrix.setValuesCSR(*csr_arrays(matrix))
            self._matrix.assemble()
        return self._numeric(self._matrix)

    def factor_shared(self, matrix: PETSc.Mat, *, symmetric: bool | None = None) -> bool:
        """Factor a matrix that processes share, always the same one; symmetry is looked for unless it is known."""
        size = matrix.norm(PETSc.NormType.FROBENIUS)
        if not np.isfinite(size):
            return False
        if symmetric is None:
            away = matrix.transpose(PETSc.Mat())
            away.axpy(-1.0, matrix)
            symmetric = away.norm(PETSc.NormType.FROBENIUS) <= ASYMMETRY * size
            away.destroy()
        if self._ksp is None or symmetric != self.symmetric:
            self.release()
            self._begin(matrix, symmetric)
        return self._numeric(matrix)

    def _has_pattern_of(self, matrix: csr_matrix) -> bool:
        known = self._pattern
        return (
            known is not None
            and known.nnz == matrix.nnz
            and np.array_equal(known.indptr, matrix.indptr)
            and np.array_equal(known.indices, matrix.indices)
        )

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
        if self._matrix is not None:
            self._matrix.destroy()
        self._ksp = self._matrix = self._pattern = None


def csr_arrays(matrix: csr_matrix):
    """Row starts, columns and values as PETSc takes them."""
    return matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data
