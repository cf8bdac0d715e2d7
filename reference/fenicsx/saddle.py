"""The saddle point of displacement and pressure: its matrix, and linear solvers by factors or by GMRES.

GMRES serves where factors are too big. Its preconditioner is block triangular (Elman, Silvester and Wathen 2014,
"Finite Elements and Fast Iterative Solvers", Chapter 4): one V-cycle of multigrid for the displacement's
block, and for the pressure's Schur complement the mass matrix by 1/mu + 1/kappa, a few steps of Chebyshev's iteration
between bounds that its elements give.
"""

from __future__ import annotations

import numpy as np
import ufl

from ...lhm.base.mesh import Floats, Ints
from . import dolfinx_version as seam
from .dolfinx_version import PETSc, SLEPc, free_dropped
from .linear_solvers import Factorisation, LinearAnswer, hold, multiply, petsc_vector, solve_with
from .multigrid import Multigrid, set_options
from .parallel import dot, irregular_vector
from .problem import Problem, State

PENALTY = 30.0
"""kappa by the shear modulus: the error of p₀ falls to a tenth or less per minimisation, in two or three steps each."""
SADDLES = ("cg", "mumps", "block")
LARGE_SADDLE = 400_000
"""Unknowns, from which on "cg" is GMRES. Factors, which count the inertia, take nearly twice its memory at 76,000 and
5.6 GB at 305,000, where GMRES takes 2.4."""
RESTART = 200  # vectors that GMRES keeps
MAX_LINEAR_ITERATIONS = 400
PATIENCE = 3  # times the iterations of the hardest projected system so far; beyond, a system counts as indefinite
# Of volumes among the residuals, beyond the stiffness that meets them: the springs multiply what is left of them.
WEIGHT = 10.0
STEP, FOLLOWING = 1e-4, 1e-1  # relative, of a step of displacement and pressure at once, and of the one that follows
MODES, MODE = 6, 1e-1  # how many soft motions are looked at, and how well each is found
ALIKE = 1e-10  # of the largest product of soft motions: what they have less in common with the others is rounding
_PREFIX, _PRESSURE_PREFIX = "softdeca_block_", "softdeca_pressure_"
_OPTIONS = {
    "fieldsplit_0_ksp_type": "preonly",
    "fieldsplit_0_pc_type": "none",  # until it is multigrid
    "fieldsplit_1_ksp_type": "preonly",
    "fieldsplit_1_pc_type": "ksp",
    "fieldsplit_1_ksp_ksp_type": "chebyshev",
    # The eigenvalues of diag(M)^-1 M on linear tets, whatever their weights (Wathen 1987, IMA J. Numer. Anal. 7:4).
    "fieldsplit_1_ksp_ksp_chebyshev_eigenvalues": "0.5,2.5",
    "fieldsplit_1_ksp_ksp_max_it": 5,
    "fieldsplit_1_ksp_ksp_norm_type": "none",
    "fieldsplit_1_ksp_pc_type": "jacobi",
}
_SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class SaddleMatrix:
    """[H, B; Bᵀ, D] of a mixed problem: its energy's second derivatives by displacement and pressure.

    Rows are of each rank first its displacements, then its pressures. H is what the problem's matrix holds; B [mm²]
    and D [mm³/kPa], negative semi-definite, are what `assemble` has put there. `mass` is the pressure's mass matrix by
    1/mu [mm³/kPa], that of the springs of `Condensed` a share `springs` of it, and `idle` are the pressures that no law
    has.
    """

    def __init__(self, problem: Problem):
        self.problem, self.comm, self.H = problem, problem.comm, problem.matrix
        self.displacements, self.pressures = 3 * problem.numbering.nodes.owned, problem.pressures.owned
        self.idle = problem.idle_pressures()
        space = problem.pressure.function_space
        p, q, v = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.TestFunction(problem.numbering.space)
        softness = seam.cell_numbers(space.mesh, np.arange(len(problem.solids.softness)), problem.solids.softness)
        self.B = _assemble_form(ufl.div(v) * p * ufl.dx)
        self.mass = _assemble_form(softness * p * q * ufl.dx)
        self.D, self.springs = self.mass.copy(), 1.0 / PENALTY
        self._transposed = self.B.transpose(PETSc.Mat())
        self._whole = PETSc.Mat()

    def assemble(self, state: State, *, springs: bool):
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
            self.D.axpy(-self.springs, self.mass, structure=_SAME)

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

    def __init__(self, matrix: SaddleMatrix):
        self._idle = matrix.idle
        self._matrix = matrix.D.copy()
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(_PRESSURE_PREFIX)
        self._ksp.setType(PETSc.KSP.Type.CG)
        self._ksp.getPC().setType(PETSc.PC.Type.JACOBI)
        self._ksp.setTolerances(rtol=1e-12, atol=0.0, max_it=MAX_LINEAR_ITERATIONS)

    def take(self, D: PETSc.Mat):
        """Solve by the present values of D from now on."""
        D.copy(self._matrix, structure=_SAME)
        self._matrix.scale(-1.0)
        _set_diagonal(self._matrix, self._idle, 1.0)
        self._ksp.setOperators(self._matrix)

    def solve(self, volumes: Floats) -> Floats:
        """The pressures [kPa], a vector, of volumes [mm³]; not a number where they are not found."""
        x, why = solve_with(self._ksp, volumes, 1)
        return np.full_like(x, np.nan) if why else x


def _set_diagonal(matrix: PETSc.Mat, rows: Ints, value: float):
    """Give empty rows of this rank their diagonal entry."""
    first = matrix.getOwnershipRange()[0]
    matrix.zeroRows((first + rows).astype(PETSc.IntType), diag=value)


def make_saddle_solver(kind: str, matrix: SaddleMatrix, held: Ints) -> FactoredSaddle | BlockSaddle:
    """The solver of a name in SADDLES: "mumps" by factors, "block" by GMRES, "cg" either by the number of unknowns."""
    size = 3 * matrix.problem.numbering.nodes.total + matrix.problem.pressures.total
    iterative = kind == "block" or (kind == "cg" and size >= LARGE_SADDLE)
    return BlockSaddle(matrix, held) if iterative else FactoredSaddle(matrix, held)


class FactoredSaddle:
    """A saddle matrix with held displacements (k,), flat and sorted, by MUMPS' LDLᵀ.

    H - B D⁻¹ Bᵀ is positive definite, or without springs H is wherever B does no work, if there are as many negative
    pivots as pressures.
    """

    def __init__(self, matrix: SaddleMatrix, held: Ints):
        self._matrix, self._displacements = matrix, held
        self._held: Ints = np.concatenate([held, matrix.displacements + matrix.idle])
        self._expected = matrix.comm.allreduce(matrix.pressures - len(matrix.idle))
        self._factors = Factorisation()
        self.factored = self.iterations = 0

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; exact whatever `relative` is. The pressures' equations have nothing on the right."""
        values = b[self._displacements] / self._matrix.H.getDiagonal().array_r[self._displacements]
        known = np.concatenate([b, np.zeros(self._matrix.pressures)])
        x, why = self._solve(known, np.concatenate([values, np.zeros(len(self._matrix.idle))]))
        return LinearAnswer(x[: len(b)], not why, 1, why)

    def newton_step(self, residual: Floats) -> Floats | None:
        """Newton's step of displacement and pressure, a vector, from forces and volumes that are zero where held.

        None where the tangent is not that of a minimum under the constraint.
        """
        x, why = self._solve(-residual, np.zeros(len(self._held)))
        return None if why else x

    def simplified_step(self, residual: Floats) -> Floats:
        """The `newton_step` from another residual by the same factors."""
        self.iterations += 1
        return self._factors.solve(-residual)

    @property
    def direct(self) -> FactoredSaddle:
        """Itself: see BlockSaddle."""
        return self

    def _solve(self, known: Floats, values: Floats) -> tuple[Floats, str]:
        """The solution, and why it is none or not that of a minimum."""
        whole = self._matrix.whole()
        hold(whole, self._held, values, known)
        self.factored += 1
        if not self._factors.factor(whole, symmetric=True):
            return np.zeros_like(known), "singular"
        self.iterations += 1
        excess = self._factors.negative - self._expected
        return self._factors.solve(known), f"{excess} negative pivots beyond the pressures'" if excess else ""

    def release(self):
        """Free the factors."""
        self._factors.release()


class BlockSaddle:
    """See FactoredSaddle: the same system, the same questions.

    Nothing counts the inertia. A matrix with springs counts as positive definite unless it curves the energy downwards
    along the answer, which then is no descent direction, or GMRES takes PATIENCE times what it took for the first
    matrix or one after a failure: both are projected, so those get all iterations. `newton_step` looks further, for it
    ends a solve: at the softest motions, which SLEPc finds by the inverse. Where these curve the energy downwards,
    FactoredSaddle takes over for good, which sees all of them; so it does for one step where GMRES does not find that.
    """

    def __init__(self, matrix: SaddleMatrix, held: Ints):
        self._matrix, self._held, self._comm = matrix, held, matrix.comm
        self.direct = FactoredSaddle(matrix, held)
        self._set_ups, self._last, self._iterations, self._scale = 0, 0, 0, 1.0
        self._hardest, self._failed = 0, False
        self._by_factors = self._lost = False
        self._softest: list[Floats] | None = None
        self._ksp: PETSc.KSP | None = None
        self._parts: list[PETSc.Mat] = []
        self._multigrid = Multigrid(matrix.H, matrix.problem.levels, symmetric=False)

    @property
    def factored(self) -> int:
        """How many systems were set up."""
        return self._set_ups + self.direct.factored

    @property
    def iterations(self) -> int:
        """GMRES' iterations, and the direct solver's answers."""
        return self._iterations + self.direct.iterations

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver; held dofs' equations are x = b but for a factor, as `hold` leaves them."""
        if self._lost:
            return self.direct.solve(b, relative=relative)
        matrix = self._matrix
        given = np.zeros_like(b)
        given[self._held] = b[self._held] / matrix.H.getDiagonal().array_r[self._held]
        moved = np.zeros(matrix.pressures)
        matrix.B.multTranspose(*(petsc_vector(part, matrix.comm) for part in (given, moved)))
        self._set_up()
        known = np.concatenate([b, -moved])
        known[self._held] = 0.0
        is_projected = self._failed or not self._hardest
        z, why = self._solve(known, relative, MAX_LINEAR_ITERATIONS if is_projected else PATIENCE * self._hardest)
        if is_projected and not why:
            self._hardest = max(self._hardest, self._last)
        x = z[: len(b)]
        if not (why or dot(self._comm, x, b) > 0.0 or dot(self._comm, given, given) > 0.0):
            why = "negative curvature"
        self._failed = bool(why)
        x[self._held] = given[self._held]
        return LinearAnswer(x, not why, self._last, why)

    def newton_step(self, residual: Floats) -> Floats | None:
        """See FactoredSaddle."""
        if self._lost:
            return self.direct.newton_step(residual)
        H = self._matrix.H
        hold(H, self._held, np.zeros(len(self._held)), np.zeros(self._matrix.displacements))
        self._set_up()
        step, why = self._solve(-residual, STEP)
        self._by_factors = bool(why)
        if why:
            return self.direct.newton_step(residual)
        if self._softest is None:
            self._softest = self._softest_motions()
        if self._bends_down([step[: self._matrix.displacements], *self._softest]):
            self._by_factors = self._lost = True
            return None
        return step

    def simplified_step(self, residual: Floats) -> Floats:
        """See FactoredSaddle; by the same preconditioner."""
        return self.direct.simplified_step(residual) if self._by_factors else self._solve(-residual, FOLLOWING)[0]

    def _free(self, motion: Floats) -> Floats:
        """A displacement as forces on what is not held, and no volumes."""
        result = np.concatenate([motion, np.zeros(self._matrix.pressures)])
        result[self._held] = 0.0
        return result

    def mult(self, _matrix: PETSc.Mat, forces: PETSc.Vec, motion: PETSc.Vec):
        """The inverse of what is set up, as SLEPc asks for it: displacements by forces, zero where GMRES finds none."""
        step, why = self._solve(self._free(forces.array_r), MODE)
        motion.array[:] = 0.0 if why else step[: self._matrix.displacements]

    def _softest_motions(self) -> list[Floats]:
        """Displacements of the lowest modes of what is set up: SLEPc's Krylov space of its inverse, made once.

        Six solves of 146 iterations of GMRES for a beam of 1,701 nodes; Lanczos by hand took 148, to the same modes.
        """
        matrix, nodes = self._matrix, self._matrix.problem.numbering
        inverse = PETSc.Mat().createPython(((matrix.displacements, None),) * 2, self, comm=self._comm)
        inverse.setUp()
        begin, mode = inverse.createVecs()
        begin.array[:] = self._free(irregular_vector(self._comm, nodes.X[: nodes.nodes.owned]))[: matrix.displacements]
        solver = SLEPc.EPS().create(self._comm)
        solver.setOperators(inverse)
        solver.setProblemType(SLEPc.EPS.ProblemType.HEP)
        solver.setDimensions(1, MODES)
        solver.setTolerances(MODE, 1)
        solver.setInitialSpace([begin])
        solver.solve()
        found = []
        for k in range(solver.getConverged()):
            solver.getEigenvector(k, mode)
            found.append(mode.array_r.copy())
        for each in (solver, inverse, begin, mode):
            each.destroy()
        return found

    def _bends_down(self, motions: list[Floats]) -> bool:
        """Whether the energy with springs bends down anywhere in the space of some displacements."""
        matrix = self._matrix
        vectors = np.stack([motion / np.sqrt(dot(self._comm, motion, motion)) for motion in motions])
        values, turned = np.linalg.eigh(self._comm.allreduce(vectors @ vectors.T))
        kept = values > ALIKE * values[-1]
        basis = (turned[:, kept] / np.sqrt(values[kept])).T @ vectors
        bent = np.array([multiply(matrix.H, motion) for motion in basis])
        stiffened = matrix.D.copy()
        stiffened.axpy(-matrix.springs, matrix.mass, structure=_SAME)
        pressures = PressureSolver(matrix)
        pressures.take(stiffened)
        for row, motion in enumerate(basis):
            volumes, forces = np.zeros(matrix.pressures), np.zeros(matrix.displacements)
            matrix.B.multTranspose(*(petsc_vector(part, matrix.comm) for part in (motion, volumes)))
            matrix.B.mult(*(petsc_vector(part, matrix.comm) for part in (pressures.solve(volumes), forces)))
            forces[self._held] = 0.0
            bent[row] += forces
        products = self._comm.allreduce(basis @ bent.T)
        return bool(np.linalg.eigvalsh((products + products.T) / 2)[0] <= 0.0)

    def _set_up(self):
        """Make GMRES anew for the matrix' present values, where held dofs are held in H."""
        self._release()
        matrix = self._matrix
        free = np.ones(matrix.displacements, dtype=bool)
        free[self._held] = False
        self._scale = WEIGHT * matrix.problem.force_per_volume(matrix.H.getDiagonal().array_r[free])
        B, D = matrix.B.copy(), matrix.D.copy()
        B.scale(self._scale)
        B.zeroRows((B.getOwnershipRange()[0] + self._held).astype(PETSc.IntType), diag=0.0)
        D.scale(self._scale**2)
        S = D.copy()
        S.axpy(-(self._scale**2), matrix.mass, structure=_SAME)
        for part in (D, S):
            _set_diagonal(part, matrix.idle, -1.0)
        self._parts = [B, B.transpose(PETSc.Mat()), D, S]
        system = PETSc.Mat().createNest([[matrix.H, B], [self._parts[1], D]], comm=matrix.comm)
        self._parts.append(system)
        set_options(_PREFIX, _OPTIONS)
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(_PREFIX)
        self._ksp.setType(PETSc.KSP.Type.GMRES)
        self._ksp.setGMRESRestart(RESTART)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._ksp.setOperators(system)
        blocks = self._ksp.getPC()
        blocks.setType(PETSc.PC.Type.FIELDSPLIT)
        rows, _ = system.getNestISs()
        blocks.setFieldSplitIS(("0", rows[0]), ("1", rows[1]))
        blocks.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
        blocks.setFieldSplitSchurFactType(PETSc.PC.SchurFactType.UPPER)
        blocks.setFieldSplitSchurPreType(PETSc.PC.SchurPreType.USER, S)
        self._ksp.setFromOptions()
        self._ksp.setUp()
        self._multigrid.set_up(blocks.getFieldSplitSubKSP()[0].getPC())
        self._set_ups += 1

    def _solve(self, known: Floats, relative: float, limit: int = MAX_LINEAR_ITERATIONS) -> tuple[Floats, str]:
        """Displacements and pressures from forces and volumes, a vector, and why they are none."""
        assert self._ksp is not None
        known = np.array(known)
        known[self._matrix.displacements :] *= self._scale
        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=limit)
        answer, why = solve_with(self._ksp, known, 1)
        answer[self._matrix.displacements :] *= self._scale
        answer[self._held] = 0.0  # GMRES leaves its residual there
        self._last = self._ksp.its
        self._iterations += self._last
        return answer, why

    def release(self):
        """Free all that is kept."""
        self._release()
        self.direct.release()

    def _release(self):
        if self._ksp is not None:
            self._ksp.destroy()
        for part in reversed(self._parts):
            part.destroy()
        self._ksp, self._parts = None, []
        free_dropped(self._comm)
