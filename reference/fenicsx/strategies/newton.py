"""Newton's method on the energy: hybrid projection, inexact linear solves, Armijo's line search.

Far from the answer every point's tangent is projected to be positive semi-definite, which always gives a descent
direction; once the gradient has fallen thirtyfold the exact tangent takes over, and converges quadratically. Where the
exact Hessian is not positive definite, or its direction does not descend, that iteration uses the projected one, and
the next ones keep only a share of the negative curvature: projection alone converges linearly, and slowly where
tissue is inverted or skin compressed (50 iterations became 20). A step as far as CG came before negative curvature
takes fewer iterations, but leaves the minimum nearest to the start for others (.4 mm away on a face that folds).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...solution import Reason
from ..dolfinx_version import MPI, PETSc
from ..linear.solvers import LinearSolver, hold
from ..mesh.parallel import IndexMap, anywhere, dot, largest_size, norm
from ..policy import NewtonPolicy


class AnyState(Protocol):
    """An energy at one place: the displacement `u` [mm], a field (n, 3), and what Newton's method needs there."""

    u: Floats

    @property
    def energy(self) -> float:
        """The energy [µJ], infinite or not a number where there is none."""
        ...

    def gradient(self) -> Floats:
        """Its gradient [mN] by the unknowns, a vector, held ones included."""
        ...

    def hessian(self, kept: float = 1.0) -> PETSc.Mat:
        """Its Hessian [mN/mm], in a matrix that is always the same.

        Negative eigenvalues of points' tangents are multiplied by `kept` in [0, 1].
        """
        ...


class Minimised(Protocol):
    """A problem with an energy, its gradient and its Hessian."""

    comm: MPI.Intracomm

    @property
    def energy_scale(self) -> float:
        """An energy [µJ] that the scene's stiffness gives to displacements of its size."""
        ...

    def moved(self, state: Any, step: Floats) -> AnyState:
        """The state after a step [mm], a vector."""
        ...


@dataclass
class Work:
    """Cost of a solve."""

    linear_iterations: int = 0
    linear_solves: int = 0
    fallback_solves: int = 0
    energies: int = 0


@dataclass(eq=False)
class Newton:
    """A problem, the dofs that are held (sorted, flat), the usual linear solver and the one that it falls back to.

    Steps and gradients are vectors: every rank has what it owns, and all decide by the same products and norms.
    `report` is called with state and gradient norm after each iteration and returns whether to stop.
    """

    problem: Minimised
    held: Ints
    linear: LinearSolver
    fallback: LinearSolver
    report: Callable[[AnyState, float], bool]
    work: Work = field(default_factory=Work)
    policy: NewtonPolicy = NewtonPolicy()
    _kept: float = 1.0
    _successes: int = 0

    def free_gradient(self, state: AnyState) -> Floats:
        """The gradient [mN], a vector, zero at held dofs."""
        gradient = state.gradient().ravel()
        gradient[self.held] = 0.0
        return gradient

    def norm(self, vector: Floats) -> float:
        """The norm of a vector that the ranks share."""
        return norm(self.problem.comm, vector)

    def extension(self, state: AnyState, jump: Floats) -> tuple[Floats, float]:
        """How a jump of the held dofs [mm], a vector (owned, 3), spreads by the projected Hessian; its forces' norm.

        The displacement, a vector too, equals the jump at held dofs. A direct lift would crush the elements next to
        them.
        """
        values = jump.ravel()[self.held]
        forces = np.zeros(jump.size)

        def set_up(shift: float) -> Floats:
            nonlocal forces
            forces = np.zeros(jump.size)
            matrix = self._shift(state.hessian(0.0), shift)
            hold(matrix, self.held, values, forces)
            return forces

        spread = self._solve(set_up, relative=1e-6)
        forces[self.held] = 0.0
        force = self.norm(forces)
        if spread is None:
            return jump, force
        spread[self.held] = values  # an iterative solver leaves its residual there
        return spread.reshape(jump.shape), force

    def approach(
        self,
        state: AnyState,
        goal: Floats,
        nodes: IndexMap,
        at: Callable[[Floats], AnyState],
        *,
        threshold: Callable[[float, float], float],
        max_iterations: int,
    ) -> tuple[AnyState, float, Reason | None, int]:
        """Move what is held to a goal [mm], a field (n, 3), in as few load steps as keep the energy finite.

        From a state of no finite energy there is no way, which is reported. `at` gives the state at a field. A step
        before the last is minimised to the gradient norm that `threshold` gives from its first one and the norm of the
        forces that its motion causes [mN].

        Returns the state with everything in place, the norm of the last step's forces, the reason where it did not get
        there (None if it did), and the iterations made.
        """
        made = 0
        if not np.isfinite(state.energy):
            self.report(state, np.inf)
            return state, 0.0, Reason.NOT_FINITE, made
        while True:
            begin, end = (field[: nodes.owned] for field in (state.u, goal))
            jump = np.zeros_like(begin)
            jump.flat[self.held] = end.flat[self.held] - begin.flat[self.held]
            if not anywhere(nodes.comm, jump):
                return state, 0.0, None, made
            spread, force = self.extension(state, jump)
            fraction, lifted = 1.0, None
            while lifted is None:
                u = begin + fraction * spread
                if fraction == 1.0:
                    u.flat[self.held] = end.flat[self.held]
                lifted = at(nodes.spread(u))
                if not np.isfinite(lifted.energy):
                    fraction, lifted = 0.5 * fraction, None
                if fraction < self.policy.smallest_fraction:
                    return state, force, Reason.LINE_SEARCH, made
            if fraction == 1.0:
                return lifted, force, None, made
            last = partial(threshold, fraction * force)
            state, reason, iterations = self.minimise(lifted, threshold=last, max_iterations=max_iterations - made)
            made += iterations
            if reason is not Reason.CONVERGED:
                return state, force, reason, made

    def minimise(
        self, state: AnyState, *, threshold: Callable[[float], float], max_iterations: int, near: bool = False
    ) -> tuple[AnyState, Reason, int]:
        """Iterate from a state of finite energy; give the last state, the reason to stop, and the iterations made.

        `threshold` gives the gradient norm to stop at, from the first one; `near` an answer, the exact tangent is tried
        from the beginning.
        """
        gradient = self.free_gradient(state)
        norm = first = self.norm(gradient)
        last, stalled = threshold(first), 0
        for iteration in range(max_iterations + 1):
            if self.report(state, norm):
                return state, Reason.INTERRUPTED, iteration
            if norm <= last:
                return state, Reason.CONVERGED, iteration
            if iteration == max_iterations:
                break
            relative = min(max(min(1e-3, norm / first), 0.1 * last / norm, 1e-10), 0.1)
            after = self._step(state, gradient, exact=near or norm < self.policy.exact_below * first, relative=relative)
            if isinstance(after, Reason):
                return state, after, iteration
            gradient = self.free_gradient(after)
            norm_after = self.norm(gradient)
            fall = state.energy - after.energy
            if fall <= self._find_rounding(state) and norm_after >= norm:
                # Rounding of great stiffness may hide what soft tissue still gains.
                stalled += 1
                if fall <= 0.0 or stalled > self.policy.patience:
                    return state, Reason.STAGNATED, iteration
            state, norm = after, norm_after
        return state, Reason.MAX_ITERATIONS, max_iterations

    def find_soft_motion(self, state: Any, begin: Floats, shift: float) -> Floats | None:
        """The motion [1], a vector, along which an indefinite exact Hessian is softest; None where it is definite.

        Inverse iterations from a vector. The Hessian has a share of its largest diagonal entry added.
        """
        matrix = self._shift(state.hessian(), shift)
        mode = np.array(begin)
        mode[self.held] = 0.0
        hold(matrix, self.held, np.zeros(len(self.held)), np.zeros_like(mode))
        for _ in range(self.policy.mode_iterations):
            answer = self.fallback.solve(mode, relative=0.0)
            size = largest_size(self.problem.comm, answer.x)
            if answer.converged or size == 0.0:
                return None
            mode = answer.x / size
        return mode

    def _step(self, state: AnyState, gradient: Floats, *, exact: bool, relative: float) -> AnyState | Reason:
        """The next state, or why there is none."""
        if exact and self._kept > 0.0:
            after = self._advance(state, gradient, self._kept, relative)
            if not isinstance(after, Reason):
                self._successes += 1
                if self._successes >= self.policy.successes:
                    self._kept, self._successes = min(1.0, self._kept + self.policy.curvature_share), 0
                return after
            self._kept, self._successes = self._kept - self.policy.curvature_share, 0
        elif exact:
            self._kept = self.policy.curvature_share
        return self._advance(state, gradient, 0.0, relative)

    def _advance(self, state: AnyState, gradient: Floats, kept: float, relative: float) -> AnyState | Reason:
        """One iteration with a share of the negative curvature kept; only the projected Hessian is sure to do."""
        if 0.0 < kept < 1.0:
            relative = max(relative, self.policy.loose)

        def set_up(shift: float) -> Floats:
            b = -gradient
            hold(self._shift(state.hessian(kept), shift), self.held, np.zeros(len(self.held)), b)
            return b

        if kept == 0.0:
            direction = self._solve(set_up, relative=relative)
        else:
            direction = self._try(self.linear, set_up(0.0), relative)
        if direction is None:
            return Reason.LINEAR_SOLVER
        after, slope = self._search(state, gradient, direction)
        if after is None and abs(slope) <= self._find_rounding(state):
            return Reason.STAGNATED
        for shift in self.policy.dampings if kept == 0.0 else ():
            if after is not None:
                break
            direction = self._try(self.fallback, set_up(shift), relative)
            if direction is not None:
                after, _ = self._search(state, gradient, direction)
        return Reason.LINE_SEARCH if after is None else after

    def _solve(self, set_up: Callable[[float], Floats], *, relative: float) -> Floats | None:
        """Solve the system that set_up assembles: by the usual solver, then directly, then with growing shifts."""
        answer = self._try(self.linear, set_up(0.0), relative)
        for shift in self.policy.shifts:
            if answer is not None:
                break
            self.work.fallback_solves += 1
            answer = self._try(self.fallback, set_up(shift), relative)
        return answer

    def _try(self, solver: LinearSolver, b: Floats, relative: float) -> Floats | None:
        answer = solver.solve(b, relative=relative)
        self.work.linear_solves += 1
        self.work.linear_iterations += answer.iterations
        return answer.x if answer.converged else None

    def _shift(self, matrix: PETSc.Mat, shift: float) -> PETSc.Mat:
        if shift > 0.0:
            matrix.shift(shift * matrix.getDiagonal().norm(PETSc.NormType.INFINITY))
        return matrix

    def _find_rounding(self, state: AnyState) -> float:
        """The energy [µJ] below which differences are rounding."""
        return 1e-14 * (self.problem.energy_scale + abs(state.energy))

    def _search(self, state: AnyState, gradient: Floats, direction: Floats) -> tuple[AnyState | None, float]:
        """Search along a direction: the state after a step that lowers the energy enough, or None, and the slope."""
        direction[self.held] = 0.0
        slope = dot(self.problem.comm, gradient, direction)
        if slope >= 0.0:
            return None, slope
        step, rounding = 1.0, self._find_rounding(state)
        while step >= self.policy.smallest_step:
            self.work.energies += 1
            after = self.problem.moved(state, step * direction)
            if after.energy <= state.energy + self.policy.sufficient_decrease * step * slope + rounding:
                break
            step *= 0.5
        else:
            return None, slope
        if state.energy - after.energy > self.policy.straight * abs(slope) > rounding:
            # Where tissue buckles, the projected Hessian is far too stiff: double a full step while the energy falls.
            step = 2.0
            while step <= self.policy.longest_step:
                self.work.energies += 1
                longer = self.problem.moved(state, step * direction)
                if not longer.energy < after.energy:
                    break
                after, step = longer, 2.0 * step
        return after, slope
