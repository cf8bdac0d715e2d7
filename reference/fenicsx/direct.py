"""A direct factorisation that says how many directions lose stiffness: MUMPS' LDLᵀ, or its LU where not symmetric."""

from __future__ import annotations

import numpy as np

from ...lhm.mesh import Floats
from .dolfinx_version import PETSc

ASYMMETRY = 1e-9  # of a matrix' norm, below which it counts as symmetric
ROOM = 60  # percent beyond the estimate: saddle points delay pivots


class Factorisation:
    """Factors a matrix, always the same one, whenever its values have changed; the elimination's order is kept.

    `solve` uses the last factors. After `factor`, `negative` is the number of negative pivots of a symmetric matrix, or
    of another one 0 or 1 by the sign of its determinant.
    """

    def __init__(self):
        self._ksp: PETSc.KSP | None = None
        self.negative = 0
        self.symmetric = True

    def factor(self, matrix: PETSc.Mat, *, symmetric: bool) -> bool:
        """Factor a matrix that processes share; give whether it is regular.

        If it need not be `symmetric`, it is looked whether it is.
        """
        size = matrix.norm(PETSc.NormType.FROBENIUS)
        if not np.isfinite(size):
            return False
        if not symmetric:
            away = matrix.transpose(PETSc.Mat())
            away.axpy(-1.0, matrix)
            symmetric = away.norm(PETSc.NormType.FROBENIUS) <= ASYMMETRY * size
            away.destroy()
        # Of several processes MUMPS gives the determinant's sign for the first factors alone.
        again = symmetric or matrix.comm.size == 1
        if self._ksp is None or symmetric != self.symmetric or not again:
            self.release()
            self._begin(matrix, symmetric)
        return self._numeric(matrix)

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
        self._ksp = None
