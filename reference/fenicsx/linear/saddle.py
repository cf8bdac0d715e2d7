"""The saddle point of displacement and pressure: its matrix, and its linear solver by factors.

`saddle_block` has the one by GMRES, for systems whose factors are too big.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import ufl

from ....lhm.base.mesh import Floats, Ints
from .. import dolfinx_version as seam
from ..dolfinx_version import PETSc
from ..policy import POLICY, LinearPolicy, SaddlePolicy
from .problem import DiscreteProblem, Evaluation
from .solvers import Factorisation, LinearAnswer, hold, solve_with

_PRESSURE_PREFIX = "softdeca_pressure_"
SAME_PATTERN = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class SaddleMatrix:
    """[H, B; Bᵀ, D] of a mixed problem: its energy's second derivatives by displacement and pressure.

    Rows are of each rank first its displacements, then its pressures. H is what the problem's matrix holds; B [mm²]
    and D [mm³/kPa], negative semi-definite, are what `assemble` has put there. `mass` is the pressure's mass matrix by
    1/mu [mm³/kPa], that of the springs of `Condensed` a share `springs` of it, and `idle` are the pressures that no law
    has.
    """

    def __init__(self, problem: DiscreteProblem, policy: SaddlePolicy = POLICY.saddle):
        self.problem, self.comm, self.H = problem, problem.comm, problem.matrix
        self.displacements, self.pressures = 3 * problem.numbering.nodes.owned, problem.pressures.owned
        self.idle = problem.idle_pressures()
        space = problem.pressure.function_space
        p, q, v = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.TestFunction(problem.numbering.space)
        softness = seam.cell_numbers(space.mesh, np.arange(len(problem.solids.softness)), problem.solids.softness)
        self.B = _assemble_form(ufl.div(v) * p * ufl.dx)
        self.mass = _assemble_form(softness * p * q * ufl.dx)
        self.D, self.springs = self.mass.copy(), 1.0 / policy.penalty
        self._transposed = self.B.transpose(PETSc.Mat())
        self._whole = PETSc.Mat()

    def assemble(self, state: Evaluation, *, springs: bool):
        """Give B and D their values at a state, with or without springs."""
        state.place()
        self.B.zeroEntries()
        self.D.zeroEntries()
        for forms in self.problem.mixed_forms:
            seam.add_matrix(forms.coupling, self.B)
            seam.add_matrix(forms.by_pressure_twice, self.D)
        self.B.assemble()
        self.D.assemble()
        if springs:
            self.D.axpy(-self.springs, self.mass, structure=SAME_PATTERN)

    def whole(self) -> PETSc.Mat:
        """The blocks as one matrix, always the same one."""
        self.B.transpose(self._transposed)
        nest = PETSc.Mat().createNest([[self.H, self.B], [self._transposed, self.D]], comm=self.comm)
        nest.convert("aij", self._whole)
        nest.destroy()
        self._whole.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return self._whole


def _assemble_form(form) -> PETSc.Mat:
    compiled = seam.compile_form(form)
    matrix = seam.empty_matrix(compiled)
    seam.add_matrix(compiled, matrix)
    matrix.assemble()
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    return matrix


class PressureSolver:
    """-D by conjugate gradients: as a mass matrix is, it is well conditioned whatever the mesh."""

    def __init__(self, matrix: SaddleMatrix, policy: SaddlePolicy = POLICY.saddle):
        self._idle = matrix.idle
        self._matrix = matrix.D.copy()
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(_PRESSURE_PREFIX)
        self._ksp.setType(PETSc.KSP.Type.CG)
        self._ksp.getPC().setType(PETSc.PC.Type.JACOBI)
        self._ksp.setTolerances(rtol=1e-12, atol=0.0, max_it=policy.max_iterations)

    def take(self, D: PETSc.Mat):
        """Solve by the present values of D from now on."""
        D.copy(self._matrix, structure=SAME_PATTERN)
        self._matrix.scale(-1.0)
        set_diagonal(self._matrix, self._idle, 1.0)
        self._ksp.setOperators(self._matrix)

    def solve(self, volumes: Floats) -> Floats:
        """The pressures [kPa], a vector, of volumes [mm³]; not a number where they are not found."""
        x, why = solve_with(self._ksp, volumes, 1)
        return np.full_like(x, np.nan) if why else x


def set_diagonal(matrix: PETSc.Mat, rows: Ints, value: float):
    """Give empty rows of this rank their diagonal entry."""
    first = matrix.getOwnershipRange()[0]
    matrix.zeroRows((first + rows).astype(PETSc.IntType), diag=value)


@dataclass
class SaddleWork:
    """Cost of solves: systems that were set up or factored, and iterations, of which a direct answer is one."""

    systems: int = 0
    iterations: int = 0


@dataclass(frozen=True, eq=False)
class SaddleStep:
    """Newton's step of displacement and pressure, a vector.

    `follow` gives the step from another residual by the same factors or preconditioner, until the next system.
    """

    x: Floats
    follow: Callable[[Floats], Floats]


class FactoredSaddle:
    """A saddle matrix with held displacements (k,), flat and sorted, by MUMPS' LDLᵀ.

    H - B D⁻¹ Bᵀ is positive definite, or without springs H is wherever B does no work, if there are as many negative
    pivots as pressures.
    """

    def __init__(
        self,
        matrix: SaddleMatrix,
        held: Ints,
        policy: LinearPolicy = POLICY.linear,
        work: SaddleWork | None = None,
    ):
        self._matrix, self._displacements = matrix, held
        self._held: Ints = np.concatenate([held, matrix.displacements + matrix.idle])
        self._expected = matrix.comm.allreduce(matrix.pressures - len(matrix.idle))
        self._factors = Factorisation(policy)
        self.work = SaddleWork() if work is None else work

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; exact whatever `relative` is. The pressures' equations have nothing on the right."""
        values = b[self._displacements] / self._matrix.H.getDiagonal().array_r[self._displacements]
        known = np.concatenate([b, np.zeros(self._matrix.pressures)])
        x, why = self._solve(known, np.concatenate([values, np.zeros(len(self._matrix.idle))]))
        return LinearAnswer(x[: len(b)], not why, 1, why)

    def newton_step(self, residual: Floats) -> SaddleStep | None:
        """Newton's step from forces and volumes, a vector that is zero where held.

        None where the tangent is not that of a minimum under the constraint.
        """
        x, why = self._solve(-residual, np.zeros(len(self._held)))
        return None if why else SaddleStep(x, self._follow)

    def _follow(self, residual: Floats) -> Floats:
        self.work.iterations += 1
        return self._factors.solve(-residual)

    @property
    def direct(self) -> FactoredSaddle:
        """Itself: see BlockSaddle."""
        return self

    def _solve(self, known: Floats, values: Floats) -> tuple[Floats, str]:
        """The solution, and why it is none or not that of a minimum."""
        whole = self._matrix.whole()
        hold(whole, self._held, values, known)
        self.work.systems += 1
        if not self._factors.factor(whole, symmetric=True):
            return np.zeros_like(known), "singular"
        self.work.iterations += 1
        excess = self._factors.negative - self._expected
        return self._factors.solve(known), f"{excess} negative pivots beyond the pressures'" if excess else ""

    def release(self):
        """Free the factors."""
        self._factors.release()
