"""The linear system of displacement and pressure by GMRES: what `Saddle` solves by factors, where those are too big.

The preconditioner is block triangular (Elman, Silvester and Wathen 2014, "Finite Elements and Fast Iterative Solvers",
Chapter 4): one V-cycle of GAMG with rigid motions for the displacement's block, and for the pressure's Schur complement
the mass matrix by 1/mu + 1/kappa, a few steps of Chebyshev's iteration between bounds that its elements give.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from ...lhm.mesh import Floats, Ints
from .condensed import PENALTY, Condensed
from .direct import Factorisation, csr_arrays
from .dolfinx_version import ALONE, PETSc, free_dropped
from .linear import MULTIGRID, LinearAnswer, hold, set_options, why_not
from .saddle import Saddle

SADDLES = ("cg", "mumps", "block")
LARGE_SADDLE = 400_000
"""Unknowns, from which on "cg" is GMRES. Factors, which count the inertia, take nearly twice its memory at 76,000 and
5.6 GB at 305,000, where GMRES takes 2.4."""
RESTART = 200  # vectors that GMRES keeps
MAX_LINEAR_ITERATIONS = 400
# Of volumes among the residuals, beyond the stiffness that meets them: the springs multiply what is left of them.
WEIGHT = 8.0
STEP, FOLLOWING = 1e-4, 1e-1  # relative, of a step of displacement and pressure at once, and of the one that follows
MODES, MODE = 6, 1e-1  # how many soft motions are looked at, and how well each is found
_PREFIX = "softdeca_block_"
_OPTIONS = {
    "fieldsplit_0_ksp_type": "preonly",
    "fieldsplit_0_pc_type": "gamg",
    **{f"fieldsplit_0_{key}": value for key, value in MULTIGRID.items()},
    "fieldsplit_1_ksp_type": "preonly",
    "fieldsplit_1_pc_type": "ksp",
    "fieldsplit_1_ksp_ksp_type": "chebyshev",
    # The eigenvalues of diag(M)^-1 M on linear tets, whatever their weights (Wathen 1987, IMA J. Numer. Anal. 7:4).
    "fieldsplit_1_ksp_ksp_chebyshev_eigenvalues": "0.5,2.5",
    "fieldsplit_1_ksp_ksp_max_it": 5,
    "fieldsplit_1_ksp_ksp_norm_type": "none",
    "fieldsplit_1_ksp_pc_type": "jacobi",
}


def saddle_of(kind: str, condensed: Condensed, held: Ints) -> Saddle | BlockSaddle:
    """The solver of a name in SADDLES: "mumps" by factors, "block" by GMRES, "cg" either by the number of unknowns."""
    size = 3 * len(condensed.problem.numbering.X) + len(condensed.used)
    iterative = kind == "block" or (kind == "cg" and size >= LARGE_SADDLE)
    return BlockSaddle(condensed, held) if iterative else Saddle(condensed, held)


class BlockSaddle:
    """See Saddle: the same system, the same questions.

    Nothing counts the inertia. A matrix with springs counts as positive definite unless it curves the energy downwards
    along the answer, which then is no descent direction. `correction` looks further, for it ends a solve: at the
    softest motions that a few steps of Lanczos' method find by the inverse. Where these curve the energy downwards,
    `Saddle` takes over for good, which sees all of them; so it does for one step where GMRES does not find that.
    """

    def __init__(self, condensed: Condensed, held: Ints):
        self._condensed, self._held = condensed, held
        self.direct = Saddle(condensed, held)
        self.free: Ints = self.direct.free
        self._set_ups, self._last, self._iterations, self._scale = 0, 0, 0, 1.0
        self._by_factors = self._lost = False
        self._softest: Floats | None = None
        self._ksp: PETSc.KSP | None = None
        self._parts: list[PETSc.Mat] = []
        set_options(_PREFIX, _OPTIONS)

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
        given = b[self._held] / self._condensed.problem.matrix.getDiagonal().array[self._held]
        B = self._set_up(springs=True)
        forces = np.array(b)
        forces[self._held] = 0.0
        x, _, why = self._solved(forces, -(B[self._held].T @ given), relative)
        if not (why or given.any() or x @ b > 0.0):
            why = "negative curvature"
        x[self._held] = given
        return LinearAnswer(x, not why, self._last, why)

    def correction(self, forces: Floats, volumes: Floats) -> tuple[Floats, Floats] | None:
        """See Saddle."""
        if self._lost:
            return self.direct.correction(forces, volumes)
        H = self._condensed.problem.matrix
        hold(H, self._held, np.zeros(len(self._held)), np.zeros(H.getSize()[0]))
        B = self._set_up(springs=False)
        u, p, why = self._solved(-self._spread(forces), -volumes, STEP)
        self._by_factors = bool(why)
        if why:
            return self.direct.correction(forces, volumes)
        if self._softest is None:
            self._softest = self._inverse_lanczos()
        if self._bends_down(np.column_stack([u, self._softest]), B[self.free]):
            self._by_factors = self._lost = True
            return None
        return u[self.free], p

    def again(self, forces: Floats, volumes: Floats) -> Floats:
        """See Saddle; by the same preconditioner."""
        if self._by_factors:
            return self.direct.again(forces, volumes)
        return self._solved(-self._spread(forces), -volumes, FOLLOWING)[0][self.free]

    def _spread(self, free: Floats) -> Floats:
        values = np.zeros(self._condensed.problem.matrix.getSize()[0])
        values[self.free] = free
        return values

    def _inverse_lanczos(self) -> Floats:
        """Displacements (3n, MODES) that hold the lowest modes of what is set up: a Krylov space of its inverse."""
        force = self._spread(np.random.default_rng(0).normal(size=len(self.free)))
        none = np.zeros(len(self._condensed.used))
        found: list[Floats] = []
        for _ in range(MODES):
            mode, _, why = self._solved(force, none, MODE)
            if why or not mode.any():
                break
            for other in found * 2:
                mode = mode - (other @ mode) * other
            found.append(mode / np.linalg.norm(mode))
            force = self._spread(found[-1][self.free])
        return np.stack(found, axis=1) if found else np.empty((len(force), 0))

    def _bends_down(self, motions: Floats, B: csr_matrix) -> bool:
        """Whether the energy with springs bends down anywhere in a space (3n, k), by the coupling (free, used)."""
        basis = np.linalg.qr(motions)[0]
        indptr, indices, values = self._condensed.problem.matrix.getValuesCSR()
        H = csr_matrix((values, indices, indptr), shape=(len(basis), len(basis)))
        volumes = B.T @ basis[self.free]
        factors = Factorisation()
        factors.factor(self._condensed.compliance(springs=True), symmetric=True)
        pressures = np.stack([factors.solve(np.ascontiguousarray(column)) for column in volumes.T], axis=1)
        factors.release()
        bent = basis.T @ (H @ basis) + volumes.T @ pressures
        return bool(np.linalg.eigvalsh((bent + bent.T) / 2)[0] <= 0.0)

    def _set_up(self, *, springs: bool) -> csr_matrix:
        """Make GMRES anew for the problem's present matrix, whose held dofs are held; give the coupling (3n, used)."""
        self._release()
        H = self._condensed.problem.matrix
        size = H.getSize()[0]
        coupling = self._condensed.coupling()
        open_ = np.zeros(size)
        open_[self.free] = 1.0
        cells = self._condensed.problem.numbering.cell_volumes
        self._scale = WEIGHT * float(H.getDiagonal().array[self.free].mean() / np.cbrt(cells.mean()) ** 2)
        B = csr_matrix(diags(self._scale * open_) @ coupling)
        C = self._scale**2 * self._condensed.compliance(springs=springs)
        S = C + self._scale**2 * PENALTY * self._condensed.softness()
        self._parts = [_matrix(part) for part in (B, csr_matrix(B.T), -C, -S)]
        system = PETSc.Mat().createNest([[H, self._parts[0]], [self._parts[1], self._parts[2]]], comm=ALONE)
        self._parts.append(system)
        self._ksp = PETSc.KSP().create(ALONE)
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
        blocks.setFieldSplitSchurPreType(PETSc.PC.SchurPreType.USER, self._parts[3])
        self._ksp.setFromOptions()
        self._set_ups += 1
        return coupling

    def _solved(self, forces: Floats, volumes: Floats, relative: float) -> tuple[Floats, Floats, str]:
        """Displacements (3n,) and pressures (used,) from the right-hand sides, and why they are none."""
        assert self._ksp is not None
        known = np.concatenate([forces, self._scale * volumes])
        answer = np.zeros_like(known)
        self._ksp.setTolerances(rtol=relative, atol=0.0, max_it=MAX_LINEAR_ITERATIONS)
        right, left = _vector(known), _vector(answer)
        try:
            self._ksp.solve(right, left)
            why = why_not(self._ksp, left)
        except PETSc.Error as error:
            why = f"PETSc error {error.ierr}"
        right.destroy()
        left.destroy()
        self._last = self._ksp.its
        self._iterations += self._last
        return answer[: len(forces)], self._scale * answer[len(forces) :], why

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
        free_dropped()


def _vector(values: Floats) -> PETSc.Vec:
    return PETSc.Vec().createWithArray(values, comm=ALONE)


def _matrix(values: csr_matrix) -> PETSc.Mat:
    return PETSc.Mat().createAIJ(values.shape, csr=csr_arrays(values), comm=ALONE)
