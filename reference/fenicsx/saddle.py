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
from .dolfinx_version import PETSc, free_dropped
from .linear_solvers import Factorisation, LinearAnswer, hold, multiply, petsc_vector, solve_with
from .multigrid import Multigrid, set_options
from .parallel import dot, irregular_vector
from .policy import DEFAULT, FenicsxPolicy, LinearPolicy, SaddlePolicy
from .problem import Problem, State

SADDLES = ("cg", "mumps", "block")
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

    def __init__(self, problem: Problem, policy: SaddlePolicy = DEFAULT.saddle):
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

    def __init__(self, matrix: SaddleMatrix, policy: SaddlePolicy = DEFAULT.saddle):
        self._idle = matrix.idle
        self._matrix = matrix.D.copy()
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(_PRESSURE_PREFIX)
        self._ksp.setType(PETSc.KSP.Type.CG)
        self._ksp.getPC().setType(PETSc.PC.Type.JACOBI)
        self._ksp.setTolerances(rtol=1e-12, atol=0.0, max_it=policy.max_iterations)

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


def make_saddle_solver(
    kind: str, matrix: SaddleMatrix, held: Ints, policy: FenicsxPolicy = DEFAULT
) -> FactoredSaddle | BlockSaddle:
    """The solver of a name in SADDLES: "mumps" by factors, "block" by GMRES, "cg" either by the number of unknowns."""
    size = 3 * matrix.problem.numbering.nodes.total + matrix.problem.pressures.total
    iterative = kind == "block" or (kind == "cg" and size >= policy.saddle.large)
    return BlockSaddle(matrix, held, policy) if iterative else FactoredSaddle(matrix, held, policy.linear)


class FactoredSaddle:
    """A saddle matrix with held displacements (k,), flat and sorted, by MUMPS' LDLᵀ.

    H - B D⁻¹ Bᵀ is positive definite, or without springs H is wherever B does no work, if there are as many negative
    pivots as pressures.
    """

    def __init__(self, matrix: SaddleMatrix, held: Ints, policy: LinearPolicy = DEFAULT.linear):
        self._matrix, self._displacements = matrix, held
        self._held: Ints = np.concatenate([held, matrix.displacements + matrix.idle])
        self._expected = matrix.comm.allreduce(matrix.pressures - len(matrix.idle))
        self._factors = Factorisation(policy)
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
    along the answer, which then is no descent direction, or GMRES is `patience` times as slow as for the first matrix
    or one after a failure: both are projected, so those get all iterations. `newton_step` looks further, for it ends a
    solve: at the softest motions. Where these curve the energy downwards, later matrices are asked about them before
    GMRES is. FactoredSaddle takes over for one step where GMRES does not find that.
    """

    def __init__(self, matrix: SaddleMatrix, held: Ints, policy: FenicsxPolicy = DEFAULT):
        self._policy = policy.saddle
        self._matrix, self._held, self._comm = matrix, held, matrix.comm
        self.direct = FactoredSaddle(matrix, held, policy.linear)
        self._set_ups, self._last, self._iterations, self._scale = 0, 0, 0, 1.0
        self._per_decade, self._failed, self._by_factors = 0.0, False, False
        self._softest: Floats | None = None
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
        matrix = self._matrix
        given = np.zeros_like(b)
        given[self._held] = b[self._held] / matrix.H.getDiagonal().array_r[self._held]
        is_projected = self._failed or not self._per_decade
        if not is_projected and self._softest is not None and self._soften(self._softest, matrix.D)[0][0] <= 0.0:
            self._failed = True
            return LinearAnswer(given, False, 0, "negative curvature")
        moved = np.zeros(matrix.pressures)
        matrix.B.multTranspose(*(petsc_vector(part, matrix.comm) for part in (given, moved)))
        self._set_up()
        known = np.concatenate([b, -moved])
        known[self._held] = 0.0
        z, why = self._solve(known, relative, np.inf if is_projected else self._policy.patience * self._per_decade)
        if is_projected and not why:
            self._per_decade = max(self._per_decade, self._last / -np.log10(relative))
        x = z[: len(b)]
        if not (why or dot(self._comm, x, b) > 0.0 or dot(self._comm, given, given) > 0.0):
            why = "negative curvature"
        self._failed = bool(why)
        x[self._held] = given[self._held]
        return LinearAnswer(x, not why, self._last, why)

    def newton_step(self, residual: Floats) -> Floats | None:
        """See FactoredSaddle."""
        matrix = self._matrix
        hold(matrix.H, self._held, np.zeros(len(self._held)), np.zeros(matrix.displacements))
        self._set_up()
        stiffened = matrix.D.copy()
        stiffened.axpy(-matrix.springs, matrix.mass, structure=_SAME)
        motions = self._find_motions() if self._softest is None else self._softest
        stiffness, self._softest = self._soften(motions, stiffened)
        step, why = np.zeros(0), ""
        if stiffness[0] > 0.0:
            step, why = self._solve(-residual, self._policy.step)
            self._by_factors = bool(why)
            motions = np.concatenate([step[None, : matrix.displacements], self._softest])
            stiffness, self._softest = self._soften(motions, stiffened)
        stiffened.destroy()
        if why:
            return self.direct.newton_step(residual)
        return step if stiffness[0] > 0.0 else None

    def simplified_step(self, residual: Floats) -> Floats:
        """See FactoredSaddle; by the same preconditioner."""
        if self._by_factors:
            return self.direct.simplified_step(residual)
        return self._solve(-residual, self._policy.following)[0]

    def _find_motions(self) -> Floats:
        """Displacements (k, n) by which GMRES comes from rest to what irregular forces do to what is set up.

        They span what it has seen of the matrix. A soft motion takes part in the answer more than in the forces, so
        GMRES has seen it by the time that the residual is small.
        """
        matrix, nodes = self._matrix, self._matrix.problem.numbering
        forces = np.zeros(matrix.displacements + matrix.pressures)
        forces[: matrix.displacements] = irregular_vector(self._comm, nodes.X[: nodes.nodes.owned]).ravel()
        forces[self._held] = 0.0
        places: list[Floats] = []

        def remember(ksp: PETSc.KSP, _iteration: int, _residual: float):
            places.append(ksp.buildSolution().array_r[: matrix.displacements].copy())

        assert self._ksp is not None
        self._ksp.setMonitor(remember)
        self._solve(forces, self._policy.mode, self._policy.patience * self._per_decade or np.inf)
        self._ksp.cancelMonitor()
        motions = np.diff(places, axis=0)
        motions[:, self._held] = 0.0
        return motions

    def _soften(self, motions: Floats, D: PETSc.Mat) -> tuple[Floats, Floats]:
        """Ritz values (k,) [mN/mm] and motions (k, n), softest first and at most `modes`, of H - B D⁻¹ Bᵀ.

        They are those in the space of some displacements (m, n).
        """
        matrix = self._matrix
        lengths = np.sqrt(self._comm.allreduce(np.sum(motions**2, axis=1)))
        if not lengths.any():  # everything is held
            return np.full(1, np.inf), motions
        vectors = motions[lengths > 0.0] / lengths[lengths > 0.0, None]
        values, turned = np.linalg.eigh(self._comm.allreduce(vectors @ vectors.T))
        kept = values > self._policy.alike * values[-1]
        basis = (turned[:, kept] / np.sqrt(values[kept])).T @ vectors
        bent = np.array([multiply(matrix.H, motion) for motion in basis])
        pressures = PressureSolver(matrix, self._policy)
        pressures.take(D)
        for row, motion in enumerate(basis):
            volumes, forces = np.zeros(matrix.pressures), np.zeros(matrix.displacements)
            matrix.B.multTranspose(*(petsc_vector(part, matrix.comm) for part in (motion, volumes)))
            matrix.B.mult(*(petsc_vector(part, matrix.comm) for part in (pressures.solve(volumes), forces)))
            forces[self._held] = 0.0
            bent[row] += forces
        products = self._comm.allreduce(basis @ bent.T)
        stiffness, turned = np.linalg.eigh((products + products.T) / 2)
        return stiffness[: self._policy.modes], turned[:, : self._policy.modes].T @ basis

    def _set_up(self):
        """Make GMRES anew for the matrix' present values, where held dofs are held in H."""
        self._release()
        matrix = self._matrix
        free = np.ones(matrix.displacements, dtype=bool)
        free[self._held] = False
        self._scale = self._policy.volume_weight * matrix.problem.force_per_volume(matrix.H.getDiagonal().array_r[free])
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
        self._ksp.setType(PETSc.KSP.Type.FGMRES)
        self._ksp.setGMRESRestart(self._policy.restart)
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

    def _solve(self, known: Floats, relative: float, slowest: float = np.inf) -> tuple[Floats, str]:
        """Displacements and pressures from forces and volumes, a vector, and why they are none.

        GMRES ends where it takes more than `slowest` iterations for a decade, after as many for a decade in advance.
        """
        assert self._ksp is not None
        known = np.array(known)
        known[self._matrix.displacements :] *= self._scale
        reasons, first = PETSc.KSP.ConvergedReason, 0.0

        def judge(_ksp: PETSc.KSP, iteration: int, residual: float) -> int:
            nonlocal first
            if not np.isfinite(residual):
                return reasons.DIVERGED_NANORINF
            first = residual if iteration == 0 else first
            if residual <= relative * first:
                return reasons.CONVERGED_RTOL
            is_slow = iteration > slowest * (1.0 + np.log10(first / residual))
            return reasons.DIVERGED_MAX_IT if is_slow else reasons.ITERATING

        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=self._policy.max_iterations)
        self._ksp.setConvergenceTest(judge)
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
