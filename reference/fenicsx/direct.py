"""A direct factorisation that says how many directions lose stiffness: MUMPS' LDLᵀ, or its LU where not symmetric."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.mesh import Floats
from .dolfinx_version import COMM, PETSc

ASYMMETRY = 1e-9  # of the largest entry, below which a matrix counts as symmetric


class Factorisation:
    """Factors a matrix that keeps its pattern from call to call; `solve` uses the last one.

    After `factor`, `negative` is the number of negative pivots of a symmetric matrix, or of another one 0 or 1 by the
    sign of its determinant.
    """

    def __init__(self):
        self._ksp: PETSc.KSP | None = None
        self._matrix: PETSc.Mat | None = None
        self.negative = 0
        self.symmetric = True

    def factor(self, matrix: csr_matrix, *, symmetric: bool | None = None) -> bool:
        """Factor a matrix (n, n); give whether it is regular. Symmetry is looked for unless it is known."""
        n = matrix.shape[0]
        if symmetric is None:
            symmetric = n == 0 or abs(matrix - matrix.T).max() <= ASYMMETRY * abs(matrix).max()
        self.symmetric = bool(symmetric)
        if not np.isfinite(matrix.data).all():
            return False
        self._matrix = PETSc.Mat().createAIJ(
            matrix.shape,
            csr=(matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data),
            comm=COMM,
        )
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, self.symmetric)
        ksp = PETSc.KSP().create(COMM)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.setOperators(self._matrix)
        preconditioner = ksp.getPC()
        preconditioner.setType(PETSc.PC.Type.CHOLESKY if self.symmetric else PETSc.PC.Type.LU)
        preconditioner.setFactorSolverType("mumps")
        preconditioner.setFactorSetUpSolverType()
        factors = preconditioner.getFactorMatrix()
        factors.setMumpsIcntl(14, 60)  # percent of room beyond the estimate: saddle points delay pivots
        if not self.symmetric:
            factors.setMumpsIcntl(33, 1)
        try:
            ksp.setUp()
        except PETSc.Error:
            return False
        self._ksp = ksp
        if factors.getMumpsInfog(1) < 0:
            return False
        if self.symmetric:
            self.negative = factors.getMumpsInfog(12)
        else:
            self.negative = int(factors.getMumpsRinfog(12) < 0)
        return True

    def solve(self, b: Floats) -> Floats:
        """Give x of A x = b, shape (n,)."""
        x = np.zeros_like(b)
        assert self._ksp is not None
        self._ksp.solve(PETSc.Vec().createWithArray(b, comm=COMM), PETSc.Vec().createWithArray(x, comm=COMM))
        return x
