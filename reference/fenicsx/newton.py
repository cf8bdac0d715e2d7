"""Newton's method on the energy: hybrid projection, inexact linear solves, Armijo's line search.

Far from the answer every point's tangent is projected to be positive semi-definite, which always gives a descent
direction; once the gradient has fallen thirtyfold the exact tangent takes over, and converges quadratically. Where the
exact Hessian is not positive definite, or its direction does not descend, that iteration uses the projected one, and
the next ones keep only a share of the negative curvature: projection alone converges linearly, and slowly where
tissue is inverted or skin compressed (50 iterations became 20).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..solution import Reason
from .dolfinx_version import MPI, PETSc
from .linear import LinearSolver, hold
from .shared import Shared, anywhere, dot, norm

SMALLEST_FRACTION = 1 / 64  # of the motion of what is held, in one load step
EXACT_BELOW = 0.03  # of the first gradient norm
SUFFICIENT = 1e-4  # Armijo's share of the predicted decrease
STRAIGHT = 0.75  # of the predicted decrease (a parabola's is 1/2): beyond it a longer step pays
LONGEST_STEP = 64.0
SMALLEST_STEP = 2.0**-30
SHARE = 0.25  # of the negative curvature, that a Hessian which is not positive definite gives up
SUCCESSES = 2  # with a share of it, after which more is tried
DAMPINGS = (1e-3, 1e-2, 1e-1)  # of the largest diagonal entry: added where the projected Hessian leads nowhere
SHIFTS = (0.0, 1e-10, 1e-6)  # of the largest diagonal entry: what a direct solver adds where nothing holds a part


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

    def hessian(self) -> PETSc.Mat:
        """Its Hessian [mN/mm], in a matrix that is always the same."""
        ...

    def softened_hessian(self, kept: float) -> PETSc.Mat:
        """The Hessian with negative eigenvalues of points' tangents multiplied by `kept` in [0, 1]."""
        ...


class Minimised(Protocol):
    """What has an energy."""

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
    """What a solve cost."""

    linear_iterations: int = 0
    linear_solves: int = 0
    fallback_solves: int = 0
    energies: int = 0


@dataclass(eq=False)
class Newton:
    """A problem, the dofs that are held (sorted, flat), the usual linear solver and the one that it falls back to.

    Steps and gradients are vectors: every process has what it owns, and all decide by the same products and norms.
    `report` is called with state and gradient norm after each iteration and returns whether to stop.
    """

    problem: Minimised
    held: Ints
    linear: LinearSolver
    fallback: LinearSolver
    report: Callable[[AnyState, float], bool]
    work: Work = field(default_factory=Work)
    _kept: float = 1.0
    _successes: int = 0

    def free_gradient(self, state: AnyState) -> Floats:
        """The gradient [mN], a vector, zero at held dofs."""
        gradient = state.gradient().ravel()
        gradient[self.held] = 0.0
        return gradient

    def norm(self, vector: Floats) -> float:
        """The norm of a vector that the processes share."""
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
            matrix = self._shifted(state.softened_hessian(0.0), shift)
            hold(matrix, self.held, values, forces)
            return forces

        spread = self._solve(set_up, relative=1e-6)
        forces[self.held] = 0.0
        force = self.norm(forces)
        if spread is None:
            return jump, force
        spread[self.held] = values  # an iterative solver leaves its residual there
        return spread.reshape(jump.shape), force

    def lift(
        self, state: AnyState, goal: Floats, nodes: Shared, at: Callable[[Floats], AnyState]
    ) -> tuple[AnyState | None, float, float]:
        """Move what is held as far to a goal [mm], a field (n, 3), as keeps the energy finite that `at` gives a field.

        The state, None where there is none, the share of the way, and the norm of the forces that this causes [mN].
        """
        begin, end = (field[: nodes.owned] for field in (state.u, goal))
        jump = np.zeros_like(begin)
        jump.flat[self.held] = end.flat[self.held] - begin.flat[self.held]
        if not anywhere(nodes.comm, jump):
            return state, 1.0, 0.0
        spread, force = self.extension(state, jump)
        fraction = 1.0
        while fraction >= SMALLEST_FRACTION:
            u = begin + fraction * spread
            if fraction == 1.0:
                u.flat[self.held] = end.flat[self.held]
            lifted = at(nodes.spread(u))
            if np.isfinite(lifted.energy):
                return lifted, fraction, fraction * force
            fraction *= 0.5
        return None, 0.0, 0.0

    def minimise(
        self, state: AnyState, *, threshold: Callable[[float], float], max_iterations: int, near: bool = False
    ) -> tuple[AnyState, Reason, int]:
        """Iterate from a state of finite energy; give the last state, the reason to stop, and the iterations made.

        `threshold` gives the gradient norm to stop at, from the first one; `near` an answer, the exact tangent is tried
        from the beginning.
        """
        gradient = self.free_gradient(state)
        norm = first = self.norm(gradient)
        last = threshold(first)
        for iteration in range(max_iterations + 1):
            if self.report(state, norm):
                return state, Reason.INTERRUPTED, iteration
            if norm <= last:
                return state, Reason.CONVERGED, iteration
            if iteration == max_iterations:
                break
            relative = min(max(min(1e-3, norm / first), 0.1 * last / norm, 1e-10), 0.1)
            after = self._step(state, gradient, exact=near or norm < EXACT_BELOW * first, relative=relative)
            if isinstance(after, Reason):
                return state, after, iteration
            gradient = self.free_gradient(after)
            norm_after = self.norm(gradient)
            if state.energy - after.energy <= self._rounding(state) and norm_after >= norm:
                return state, Reason.STAGNATED, iteration
            state, norm = after, norm_after
        return state, Reason.MAX_ITERATIONS, max_iterations

    def stable(self, state: AnyState, shift: float = 0.0) -> bool:
        """Whether the exact Hessian, with a share of its largest diagonal entry added, is positive definite."""
        matrix = self._shifted(state.hessian(), shift)
        b = np.zeros(matrix.getLocalSize()[0])
        hold(matrix, self.held, np.zeros(len(self.held)), b)
        return self._try(self.fallback, b, 0.0) is not None

    def _step(self, state: AnyState, gradient: Floats, *, exact: bool, relative: float) -> AnyState | Reason:
        """The next state, or why there is none."""
        if exact and self._kept > 0.0:
            after = self._advance(state, gradient, self._kept, relative)
            if not isinstance(after, Reason):
                self._successes += 1
                if self._successes >= SUCCESSES:
                    self._kept, self._successes = min(1.0, self._kept + SHARE), 0
                return after
            self._kept, self._successes = self._kept - SHARE, 0
        elif exact:
            self._kept = SHARE
        return self._advance(state, gradient, 0.0, relative)

    def _advance(self, state: AnyState, gradient: Floats, kept: float, relative: float) -> AnyState | Reason:
        """One iteration with a share of the negative curvature kept; only the projected Hessian is sure to do."""

        def set_up(shift: float) -> Floats:
            b = -gradient
            hessian = state.hessian() if kept == 1.0 else state.softened_hessian(kept)
            hold(self._shifted(hessian, shift), self.held, np.zeros(len(self.held)), b)
            return b

        if kept == 0.0:
            direction = self._solve(set_up, relative=relative)
        else:
            direction = self._try(self.linear, set_up(0.0), relative)
        if direction is None:
            return Reason.LINEAR_SOLVER
        after, slope = self._along(state, gradient, direction)
        if after is None and kept == 0.0 and abs(slope) > self._rounding(state):
            after = self._damped(state, gradient, set_up, relative)
        if after is not None:
            return after
        return Reason.STAGNATED if abs(slope) <= self._rounding(state) else Reason.LINE_SEARCH

    def _along(self, state: AnyState, gradient: Floats, direction: Floats) -> tuple[AnyState | None, float]:
        """The state after a step along a direction, and the energy's slope along it; None where it leads nowhere."""
        direction[self.held] = 0.0
        slope = dot(self.problem.comm, gradient, direction)
        return (self._line_search(state, direction, slope) if slope < 0.0 else None), slope

    def _damped(
        self, state: AnyState, gradient: Floats, set_up: Callable[[float], Floats], relative: float
    ) -> AnyState | None:
        """The state after a step by the projected Hessian and a growing diagonal: alone it may be singular."""
        for shift in DAMPINGS:
            direction = self._try(self.fallback, set_up(shift), relative)
            if direction is not None:
                after, _ = self._along(state, gradient, direction)
                if after is not None:
                    return after
        return None

    def _solve(self, set_up: Callable[[float], Floats], *, relative: float) -> Floats | None:
        """Solve the system that set_up assembles: by the usual solver, then directly, then with growing shifts."""
        answer = self._try(self.linear, set_up(0.0), relative)
        for shift in SHIFTS:
            if answer is not None:
                break
            self.work.fallback_solves += 1
            answer = self._try(self.fallback, set_up(shift), relative)
        return answer

    def _try(self, solver: LinearSolver, b: Floats, relative: float) -> Floats | None:
        answer = solver.solve(b, relative=relative)
        self.work.linear_solves += 1
        self.work.linear_iterations += answer.iterations
        return answer.x if answer.found else None

    def _shifted(self, matrix: PETSc.Mat, shift: float) -> PETSc.Mat:
        if shift > 0.0:
            matrix.shift(shift * matrix.getDiagonal().norm(PETSc.NormType.INFINITY))
        return matrix

    def _rounding(self, state: AnyState) -> float:
        """The energy [µJ] below which differences are rounding."""
        return 1e-14 * (self.problem.energy_scale + abs(state.energy))

    def _moved(self, state: AnyState, step: Floats) -> AnyState:
        self.work.energies += 1
        return self.problem.moved(state, step)

    def _line_search(self, state: AnyState, direction: Floats, slope: float) -> AnyState | None:
        """The state after a step that lowers the energy enough, or None."""
        step, rounding = 1.0, self._rounding(state)
        while step >= SMALLEST_STEP:
            after = self._moved(state, step * direction)
            if after.energy <= state.energy + SUFFICIENT * step * slope + rounding:
                straight = state.energy - after.energy > STRAIGHT * abs(slope) > rounding
                return self._lengthen(state, direction, after) if straight else after
            step *= 0.5
        return None

    def _lengthen(self, state: AnyState, direction: Floats, after: AnyState) -> AnyState:
        """Double a full step while the energy falls: where tissue buckles, the projected Hessian is far too stiff."""
        step = 2.0
        while step <= LONGEST_STEP:
            longer = self._moved(state, step * direction)
            if not longer.energy < after.energy:
                break
            after, step = longer, 2.0 * step
        return after
