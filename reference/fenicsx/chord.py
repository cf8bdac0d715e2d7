"""Newton's method with one factorisation for as long as it serves, over the steps of a march.

From step to step the tangent changes little, and solving with factors at hand costs a small part of assembling and
factoring. Where the gradient stops falling fast the tangent is made anew; where that does not help either, Newton's
method with its line search takes over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.mesh import Floats, Ints
from ..solution import Reason
from .dolfinx_version import PETSc
from .linear import Mumps, hold
from .moving import MovingProblem, MovingState
from .newton import Newton

FAST = 0.3  # of the gradient norm that an iteration may leave for its factors to be kept
ROUNDING = 1e-12  # of the energy's scale, that an iteration may raise it by


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a step ended, why, after how many iterations, and how often it factored."""

    state: MovingState
    reason: Reason
    iterations: int
    factorisations: int


class Chord:
    """Steps of one moving problem; `held` are the dofs that keep their place within a step (sorted, flat)."""

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
