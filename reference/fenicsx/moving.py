"""One implicit time step as a minimisation: the scene's energy and what inertia and damping add to it.

With d the displacement since the step's beginning the sum is E(u₀ + d) + d·A d / 2 - d·r: A is constant as long as the
time step is, and r is what mass, damper and the forces of the last step ask for. Sums over d, not over u, keep rounding
small where A is large. Of u₀ and r each process has what it owns.

From step to step the tangent changes little, and solving with factors at hand costs a small part of assembling and
factoring. Where the gradient stops falling fast the tangent is made anew; where that does not help either, Newton's
method with its line search takes over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..solution import Reason
from .dolfinx_version import PETSc
from .linear import Mumps, hold
from .masses import times
from .newton import Newton
from .problem import Problem, State
from .shared import dot

FAST = 0.3  # of the gradient norm that an iteration may leave for its factors to be kept
ROUNDING = 1e-12  # of the energy's scale, that an iteration may raise it by


class MovingProblem:
    """A Problem with A (3n, 3n) added; `begin` sets u₀ [mm] and r [mN], vectors (owned, 3).

    `size` [mm] is the sum of the tets' sizes.
    """

    def __init__(self, problem: Problem, added: PETSc.Mat, size: float):
        self.problem, self.added, self.comm = problem, added, problem.comm
        # The energy that A gives to a displacement as large as those that problem's scale is made of.
        spread = float(added.getDiagonal().norm(PETSc.NormType.NORM_1)) / max(added.getSize()[0], 1)
        self._added_scale = spread * size

    def begin(self, u: Floats, r: Floats):
        """Where a step begins."""
        self.origin, self.r = u, r

    @property
    def energy_scale(self) -> float:
        """See Problem."""
        return self.problem.energy_scale + self._added_scale

    def at(self, u: Floats) -> MovingState:
        """The step at its end's displacement [mm], a field (n, 3)."""
        return MovingState(self, self.problem.at(u))

    def moved(self, state: MovingState, step: Floats) -> MovingState:
        """The step after a change of all dofs [mm], a vector (3 owned,)."""
        return self.at(state.u + self.problem.numbering.nodes.spread(step.reshape(-1, 3)))


class MovingState:
    """Energy, gradient and Hessian of a step; `static` is the scene's own part."""

    def __init__(self, owner: MovingProblem, static: State):
        self._owner, self.static, self.u = owner, static, static.u
        d = self.u[: len(owner.origin)] - owner.origin
        self._pull = times(owner.added, d)
        self.energy = static.energy + dot(owner.comm, d, 0.5 * self._pull - owner.r)

    def gradient(self) -> Floats:
        """The gradient [mN], a vector (owned, 3), held components included."""
        return self.static.gradient() + self._pull - self._owner.r

    def hessian(self) -> PETSc.Mat:
        """The exact Hessian [mN/mm], in the problem's matrix."""
        return self._with_added(self.static.hessian())

    def softened_hessian(self, kept: float) -> PETSc.Mat:
        """The Hessian with negative eigenvalues of the scene's part multiplied by `kept`."""
        return self._with_added(self.static.softened_hessian(kept))

    def _with_added(self, matrix: PETSc.Mat) -> PETSc.Mat:
        matrix.axpy(1.0, self._owner.added, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return matrix


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a step ended, why, after how many iterations, and how often it factored."""

    state: MovingState
    reason: Reason
    iterations: int
    factorisations: int


class Chord:
    """Newton's method with one factorisation for as long as it serves, over the steps of one moving problem.

    `held` are the dofs that keep their place within a step (sorted, flat).
    """

    def __init__(self, problem: MovingProblem, held: Ints, max_iterations: int):
        self._problem, self._held, self._limit = problem, held, max_iterations
        matrix = problem.problem.matrix
        self._matrix = matrix.duplicate(copy=False)
        self._factors = Mumps(self._matrix)
        mumps = Mumps(matrix)
        self._newton = Newton(problem, held, mumps, mumps, lambda *_: False)
        self._made = False

    def minimise(self, state: MovingState, threshold: float) -> Minimum:
        """Iterate from a state of finite energy until the gradient norm [mN] of what is free is at most threshold."""
        gradient, norm = self._gradient(state)
        factored, fresh = 0, False
        for iteration in range(self._limit):
            if norm <= threshold:
                return Minimum(state, Reason.CONVERGED, iteration, factored)
            if not self._made:
                self._factor(state)
                factored, fresh = factored + 1, True
            after, gradient_after, norm_after = self._moved(state, gradient)
            fell = norm_after <= FAST * norm
            if not fell:
                self._made = False
                if fresh and not norm_after < norm:
                    return self._by_newton(state, threshold, iteration, factored)
            if after is not None and norm_after < norm:
                state, gradient, norm, fresh = after, gradient_after, norm_after, False
        return Minimum(state, Reason.CONVERGED if norm <= threshold else Reason.MAX_ITERATIONS, self._limit, factored)

    def spread(self, state: MovingState, jump: Floats) -> Floats:
        """How a jump of the held dofs [mm], a vector (owned, 3), spreads to the others."""
        return self._newton.extension(state, jump)[0]

    def _gradient(self, state: MovingState) -> tuple[Floats, float]:
        gradient = state.gradient().ravel()
        gradient[self._held] = 0.0
        return gradient, self._newton.norm(gradient)

    def _factor(self, state: MovingState):
        hessian = state.hessian()
        hold(hessian, self._held, np.zeros(len(self._held)), np.zeros(hessian.getLocalSize()[0]))
        hessian.copy(self._matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._made = True

    def _moved(self, state: MovingState, gradient: Floats) -> tuple[MovingState | None, Floats, float]:
        """The state after a full step, its gradient and its norm: infinite where the step is none to take."""
        answer = self._factors.solve(-gradient, relative=0.0)
        if answer.found:
            answer.x[self._held] = 0.0
            after = self._problem.moved(state, answer.x)
            most = state.energy + ROUNDING * (self._problem.energy_scale + abs(state.energy))
            if after.energy <= most:
                return after, *self._gradient(after)
        return None, gradient, np.inf

    def _by_newton(self, state: MovingState, threshold: float, made: int, factored: int) -> Minimum:
        before = self._newton.work.linear_solves
        end, reason, iterations = self._newton.minimise(
            state,
            threshold=lambda _: threshold,
            max_iterations=self._limit - made,
            near=True,  # a thirtieth of its first gradient norm, which is small, may be less than what is asked
        )
        self._made = False
        assert isinstance(end, MovingState)
        return Minimum(end, reason, made + iterations, factored + self._newton.work.linear_solves - before)
