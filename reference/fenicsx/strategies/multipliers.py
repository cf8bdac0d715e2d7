"""The strategy "augmented Lagrangian": minimise the condensed energy, correct the pressure it starts from, and repeat.

With Π(u, p) of a mixed problem, E(u) = max over p of Π(u, p) - (p - p₀)² / (2 kappa): for J = 1 the augmented
Lagrangian of Hestenes and Powell with multiplier p₀ (Bertsekas 1982, "Constrained Optimization and Lagrange Multiplier
Methods", Chapter 2), for other laws their own energy with a bulk modulus cut down to what Newton's method can follow.
E's minimiser is the problem's own once p₀ is its pressure, whatever kappa.

Each minimisation is Newton's with line search and projection, so that large motions and crushed elements do no harm;
Newton's method on displacement and pressure at once follows as soon as its full steps work, and converges fast.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....lhm.base.mesh import Floats
from ...solution import Reason
from ..dolfinx_version import PETSc
from ..linear.problem import DiscreteProblem, Evaluation
from ..linear.saddle import PressureSolver, SaddleMatrix
from ..linear.saddle_block import make_saddle_solver
from ..linear.solvers import multiply
from ..mesh.parallel import dot, norm
from ..policy import POLICY, FenicsxPolicy
from ..run import Attempt, Run
from .equilibrium import Equilibrium
from .newton import AnyState, Newton, Work


class Condensed:
    """Energy, gradient and Hessian of E over the displacement's dofs, as `Newton` asks for them.

    `centre` is p₀ [kPa], a vector (n_p,), and `matrix` the saddle point's, whose springs are kappa's.
    """

    def __init__(self, problem: DiscreteProblem, matrix: SaddleMatrix | None = None, *, policy: FenicsxPolicy = POLICY):
        self.problem, self.comm, self._policy = problem, problem.comm, policy
        self.matrix = SaddleMatrix(problem, policy.saddle) if matrix is None else matrix
        self.centre: Floats = np.zeros(self.matrix.pressures)
        self._pressures = PressureSolver(self.matrix, policy.saddle)

    @property
    def energy_scale(self) -> float:
        """See DiscreteProblem."""
        return self.problem.energy_scale

    def begin(self, centre: Floats):
        """Begin with the first kappa and a p₀ [kPa], a vector."""
        self.matrix.springs, self.centre = 1.0 / self._policy.saddle.penalty, np.array(centre)

    def harden(self, times: float):
        """Multiply kappa."""
        self.matrix.springs /= times

    def at(self, u: Floats) -> CondensedState:
        """The energy at a displacement [mm], a field (n, 3); infinite where a law has none."""
        p = np.array(self.centre)
        static = self._place(u, p)
        self.matrix.assemble(static, springs=True)
        self._pressures.take(self.matrix.D)
        for _ in range(self._policy.multipliers.corrections):
            away = static.strain() - self.stretched(p)
            if not np.isfinite(norm(self.comm, away)):
                break
            correction = self._pressures.solve(away)
            p = p + correction
            static = self._place(u, p)
            if not norm(self.comm, correction) > self._policy.multipliers.settled * norm(self.comm, p):
                break
        return CondensedState(self, static, p, springs=True)

    def beside(self, u: Floats, p: Floats) -> CondensedState:
        """The problem itself, without springs, at a displacement, a field, and a pressure [kPa], a vector: p₀ anew."""
        self.centre = np.array(p)
        return CondensedState(self, self._place(u, p), p, springs=False)

    def moved(self, state: CondensedState, step: Floats) -> CondensedState:
        """The energy after a step of all dofs [mm], a vector (3 owned,)."""
        return self.at(state.u + self.problem.numbering.nodes.spread(step.reshape(-1, 3)))

    def stretched(self, p: Floats) -> Floats:
        """Return the volumes [mm³] that the springs hold back, a vector, zero where a minimiser solves the problem."""
        return self.matrix.springs * multiply(self.matrix.mass, p - self.centre)

    def _place(self, u: Floats, p: Floats) -> Evaluation:
        return self.problem.at(u, self.problem.pressures.spread(p))


class CondensedState:
    """Energy, gradient and Hessian at one displacement `u`, a field (n, 3), and pressure `p`, a vector (n_p,)."""

    def __init__(self, owner: Condensed, static: Evaluation, p: Floats, *, springs: bool):
        self._owner, self._static, self._springs = owner, static, springs
        self.u, self.p = static.u, p
        self.energy = static.energy
        if springs:
            self.energy -= 0.5 * dot(owner.comm, p - owner.centre, owner.stretched(p))
        self.energy = self.energy if np.isfinite(self.energy) else np.inf

    def gradient(self) -> Floats:
        """The energy's gradient [mN], a vector (owned, 3), held components included."""
        return self._static.gradient()

    def strain(self) -> Floats:
        """Π's derivative by the pressure [mm³], a vector (n_p,)."""
        return self._static.strain()

    def hessian(self, kept: float = 1.0) -> PETSc.Mat:
        """Π's second derivative by the displacement [mN/mm], see `Evaluation`, and all blocks of the owner's matrix."""
        self._owner.matrix.assemble(self._static, springs=self._springs)
        return self._static.hessian(kept)


class MultiplierDescent:
    """A run on a mixed problem, for energies without follower loads.

    `linear_solver` is as in `make_saddle_solver`; `find_start` gives the same run from a better start.
    """

    def __init__(
        self,
        run: Run,
        condensed: Condensed,
        *,
        linear_solver: str = "cg",
        find_start: Callable[[Run], Run] | None = None,
        policy: FenicsxPolicy = POLICY,
    ):
        self._policy = policy
        self._run, self._condensed, self._comm = run, condensed, condensed.comm
        self._find_start, self._nodes = find_start, run.numbering.nodes
        held = condensed.problem.held_dofs(run.held)
        self._saddle = make_saddle_solver(linear_solver, condensed.matrix, held, policy)
        self._newton = Newton(condensed, held, self._saddle, self._saddle.direct, self._report, Work(), policy.newton)
        self._equations = Equilibrium(condensed.problem, held, condensed.matrix)
        self._iterations, self._first = 0, 0.0
        self._limit = self._policy.multipliers.max_iterations

    def attempt(self) -> Attempt:
        """Lift what is held to its place, in as few load steps as keep the energy finite, and descend."""
        run = self._run if self._find_start is None else self._find_start(self._run)
        condensed, record = self._condensed, run.record
        count, self._limit = condensed.matrix.pressures, record.left(self._policy.multipliers.max_iterations)
        condensed.begin(np.zeros(count))

        def end_step(force: float, first: float) -> float:
            self._first = max(self._first, force)
            return self._policy.minimise.load_step_tolerance * max(first, self._first)

        try:
            state, force, reason, self._iterations = self._newton.approach(
                condensed.at(run.u),
                run.goal,
                self._nodes,
                condensed.at,
                threshold=end_step,
                max_iterations=self._limit,
            )
            assert isinstance(state, CondensedState)
            if reason is None:
                self._first = max(self._first, force)
                state, reason = self._alternate(state)
        finally:
            self._saddle.release()
        work = self._saddle.work
        record.add(self._iterations, linear_solves=work.systems, linear_iterations=work.iterations)
        return Attempt(reason, run.numbering, state.u, condensed.problem.pressures.spread(state.p), state.energy)

    def _report(self, state: AnyState, norm: float) -> bool:
        return self._run.report(state.u, state.energy, norm)

    def _alternate(self, state: CondensedState) -> tuple[CondensedState, Reason]:
        """Minimise and correct the pressure in turns, until forces and volumes are in balance."""
        condensed, multipliers = self._condensed, self._policy.multipliers
        self._equations.scale_volumes(state.hessian())
        self._first = max(self._first, self._norm(self._newton.free_gradient(state)))
        last = self._run.threshold(self._first)
        before = np.inf
        for turn in range(multipliers.rounds):
            share = multipliers.later_rounds if turn else multipliers.first_round
            begin = self._iterations

            def threshold(first: float, share: float = share) -> float:
                return max(share * first, last / 2)

            after, reason, made = self._newton.minimise(
                state, threshold=threshold, max_iterations=self._limit - begin, near=turn > 0
            )
            assert isinstance(after, CondensedState)
            state = after
            self._iterations += made
            if reason not in (Reason.CONVERGED, Reason.STAGNATED):
                return state, reason
            size = self._norm(state.p)
            change = self._norm(state.p - condensed.centre) / max(size, 1e-300)
            away = self._norm(condensed.stretched(state.p))
            if away > multipliers.fall * before and self._iterations <= begin + multipliers.quick:
                condensed.harden(multipliers.harder)
            before = away
            state = condensed.beside(state.u, state.p)
            # Where tissue ends without a pressure, what changes of it is rounding.
            if change <= multipliers.near or size == 0.0 or self._residual(state)[1] <= last:
                state, end = self._finish(state, last)
                if end is not None:
                    return state, end
                condensed.centre = np.array(state.p)
            state = condensed.at(state.u)
        return state, Reason.LINE_SEARCH

    def _finish(self, state: CondensedState, last: float) -> tuple[CondensedState, Reason | None]:
        """Full steps of displacement and pressure while they contract; why to stop for good, if so."""
        condensed, m = self._condensed, self._condensed.matrix.displacements
        fall = self._policy.multipliers.fall
        residual, norm = self._residual(state)
        converged = False  # only after a step: its factors say whether this is a minimum under the constraint
        while not converged and self._iterations < self._limit:
            state.hessian()
            step = self._saddle.newton_step(residual)
            if step is None:
                return state, None
            u = state.u + self._nodes.spread(step.x[:m].reshape(-1, 3))
            after = condensed.beside(u, state.p + step.x[m:])
            if not np.isfinite(after.energy):
                return state, None
            residual, norm_after = self._residual(after)
            converged = norm_after <= last
            if not (converged or norm_after <= fall * norm):
                following = step.follow(residual)
                if not self._norm(following[:m]) <= fall * self._norm(step.x[:m]):
                    return state, Reason.STAGNATED if norm <= self._run.scene.rounding() else None
            state, norm = after, norm_after
            self._iterations += 1
            if self._report(state, norm):
                return state, Reason.INTERRUPTED
        return state, Reason.CONVERGED if converged else None

    def _residual(self, state: CondensedState) -> tuple[Floats, float]:
        """Forces [mN] and volumes [mm³], a vector that is zero where held, and its norm as a force [mN]."""
        residual = np.concatenate([self._newton.free_gradient(state), state.strain()])
        return residual, self._equations.norm(residual)

    def _norm(self, vector: Floats) -> float:
        return norm(self._comm, vector)
