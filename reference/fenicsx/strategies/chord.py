"""Newton's method with one factorisation for as long as it serves, over solves of a scene that changes little.

From one time step to the next the tangent changes little, and solving with factors at hand costs a small part of
assembling and factoring. Where the gradient stops falling fast the tangent is made anew; where that does not help
either, Newton's method with its line search takes over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...solution import Reason
from ..dolfinx_version import PETSc
from ..linear.solvers import Mumps, hold
from ..policy import POLICY, ChordPolicy, LinearPolicy
from .newton import AnyState, Newton

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class KeptFactors:
    """Factors of an earlier Hessian, in a matrix of the same pattern as the one that Hessians are assembled into."""

    def __init__(self, matrix: PETSc.Mat, policy: LinearPolicy = POLICY.linear):
        self._matrix = matrix.duplicate(copy=False)
        self._factors = Mumps(self._matrix, policy=policy)
        self.exist = False

    def take(self, hessian: PETSc.Mat, held: Ints):
        """Take a Hessian whose `held` dofs keep their place."""
        hold(hessian, held, np.zeros(len(held)), np.zeros(hessian.getLocalSize()[0]))
        hessian.copy(self._matrix, structure=SAME)
        self.exist = True

    def solve(self, b: Floats) -> Floats | None:
        """Give x, or None where the Hessian was not positive definite."""
        answer = self._factors.solve(b, relative=0.0)
        return answer.x if answer.converged else None


@dataclass(eq=False)
class Chord(Newton):
    """Newton's method, by factors that its owner keeps from solve to solve as long as the gradient falls fast."""

    factors: KeptFactors = field(kw_only=True)
    chord: ChordPolicy = field(kw_only=True)

    def minimise(
        self, state: AnyState, *, threshold: Callable[[float], float], max_iterations: int, near: bool = False
    ) -> tuple[AnyState, Reason, int]:
        """See Newton."""
        gradient = self.free_gradient(state)
        norm = self.norm(gradient)
        last, fresh = threshold(norm), False
        for iteration in range(max_iterations):
            if self.report(state, norm):
                return state, Reason.INTERRUPTED, iteration
            if norm <= last:
                return state, Reason.CONVERGED, iteration
            if not self.factors.exist:
                self.factors.take(state.hessian(), self.held)
                fresh = True
            after, gradient_after, norm_after = self._try_full_step(state, gradient)
            if norm_after > self.chord.fast * norm:
                self.factors.exist = False
                if fresh and norm_after >= norm:
                    # What is asked may be less than a thirtieth of the first gradient norm, which is small here.
                    end, reason, more = super().minimise(
                        state, threshold=lambda _: last, max_iterations=max_iterations - iteration, near=True
                    )
                    return end, reason, iteration + more
            if after is not None and norm_after < norm:
                state, gradient, norm, fresh = after, gradient_after, norm_after, False
        reason = Reason.CONVERGED if norm <= last else Reason.MAX_ITERATIONS
        return state, reason, max_iterations

    def _try_full_step(self, state: AnyState, gradient: Floats) -> tuple[AnyState | None, Floats, float]:
        """The state after a full step, its gradient and its norm: infinite where the step is none to take."""
        step = self.factors.solve(-gradient)
        self.work.linear_solves += 1
        if step is not None:
            step[self.held] = 0.0
            after = self.problem.moved(state, step)
            self.work.energies += 1
            most = state.energy + self.chord.rounding * (self.problem.energy_scale + abs(state.energy))
            if after.energy <= most:
                gradient_after = self.free_gradient(after)
                return after, gradient_after, self.norm(gradient_after)
        return None, gradient, np.inf
