"""The linear system of displacement and pressure, solved for the displacement as a LinearSolver."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bmat, csr_matrix

from ...lhm.mesh import Floats, Ints
from .condensed import Condensed
from .direct import Factorisation
from .linear import LinearAnswer


class Saddle:
    """[H, B; Bᵀ, -C] of a condensed problem, with held dofs (k,) flat and sorted, by MUMPS' LDLᵀ.

    H is what the problem's matrix holds, B and C are taken where the problem was last. H + B C⁻¹ Bᵀ is positive
    definite, or without springs H is wherever B does no work, if there are as many negative pivots as pressures.
    """

    def __init__(self, condensed: Condensed, held: Ints):
        self._condensed, self._held = condensed, held
        self._count = 3 * len(condensed.problem.numbering.X)
        self.free: Ints = np.setdiff1d(np.arange(self._count), held)
        self._factors = Factorisation()
        self.factored = self.iterations = 0

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; exact whatever `relative` is. The pressures' equations have nothing on the right."""
        H = self._stiffness()
        B = self._condensed.coupling()
        x = np.zeros_like(b)
        x[self._held] = b[self._held] / H.diagonal()[self._held]
        known = np.concatenate([b[self.free], -(B[self._held].T @ x[self._held])])
        answer, why = self._solved(H, B, known, springs=True)
        x[self.free] = answer[: len(self.free)]
        return LinearAnswer(x, not why, 1, why)

    def correction(self, forces: Floats, volumes: Floats) -> tuple[Floats, Floats] | None:
        """Displacements (free,) and pressures (used,) of Newton's step without springs from forces and volumes there.

        None where the tangent is not that of a minimum under the constraint.
        """
        H, B = self._stiffness(), self._condensed.coupling()
        answer, why = self._solved(H, B, -np.concatenate([forces, volumes]), springs=False)
        return None if why else (answer[: len(self.free)], answer[len(self.free) :])

    def again(self, forces: Floats, volumes: Floats) -> Floats:
        """The displacements of `correction` (free,) from other forces and volumes, by the same factors."""
        self.iterations += 1
        return self._factors.solve(-np.concatenate([forces, volumes]))[: len(self.free)]

    @property
    def direct(self) -> Saddle:
        """Itself: see BlockSaddle."""
        return self

    def _stiffness(self) -> csr_matrix:
        indptr, indices, values = self._condensed.problem.matrix.getValuesCSR()
        return csr_matrix((values, indices, indptr), shape=(self._count, self._count))

    def _solved(self, H: csr_matrix, B: csr_matrix, known: Floats, *, springs: bool) -> tuple[Floats, str]:
        """The solution, and why it is none or not that of a minimum."""
        C = self._condensed.compliance(springs=springs)
        B = B[self.free]
        matrix = bmat([[H[self.free][:, self.free], B], [B.T, -C]], format="csr")
        self.factored += 1
        if not self._factors.factor(matrix, symmetric=True):
            return np.zeros_like(known), "singular"
        self.iterations += 1
        answer = self._factors.solve(known)
        excess = self._factors.negative - C.shape[0]
        return answer, f"{excess} negative pivots beyond the pressures'" if excess else ""

    def release(self):
        """Free the factors."""
        self._factors.release()
