"""Three ways down: plain projective dynamics, Anderson's mixing of its steps, and L-BFGS that starts from its matrix.

All are written in residual form, u -= A⁻¹ ∇E: the gradient is exact, so A decides the way but not the answer.
Steps and gradients are flat vectors over the unknowns; where rigid bodies turn, those of different points are compared
as they stand, which is exact to second order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ...lhm.base.mesh import Floats
from ..solution import Reason, Recorder
from .memory import Memory
from .policy import POLICY, DescentPolicy
from .unknowns.coordinates import Place


@dataclass(frozen=True, eq=False)
class Point:
    """A place with its energy [µJ] and the gradient [mN] over the unknowns."""

    place: Place
    energy: float
    gradient: Floats

    @property
    def u(self) -> Floats:
        """The displacement [mm], shape (n, 3)."""
        return self.place.u

    @cached_property
    def norm(self) -> float:
        """Norm of the gradient [mN]."""
        return float(np.linalg.norm(self.gradient))


@dataclass(frozen=True, eq=False)
class Objective:
    """Function to minimise: `at` evaluates a place, `move` takes a step, `precondition` is A⁻¹ on a vector at a point.

    `untangling`, where given, is the problem of an energy that leads out of inverted tets. `bounded` says that A bounds
    the energies of free vertices, so that a plain step never raises them; see `Part.is_bounded`.
    """

    at: Callable[[Place], Point]
    move: Callable[[Place, Floats], Place]
    precondition: Callable[[Floats, Point], Floats]
    untangling: Objective | None = None
    bounded: bool = True
    policy: DescentPolicy = DescentPolicy()

    def after(self, point: Point, step: Floats) -> Point:
        """The point after a step [mm] over the unknowns."""
        return self.at(self.move(point.place, step))


class Observer(Protocol):
    """Sees each point of a descent, the start first, and returns the reason to stop, if there is one."""

    def record(self, point: Point) -> Reason | None:
        """Take note of a point."""
        ...

    def forget(self) -> None:
        """Start anew to look for the best point."""
        ...


class Watch:
    """Records each iteration, says when, and why, to stop, and keeps the best point for the case of stagnation.

    `rounding` [mN]: a gradient norm below which no better point is soon a sign of rounding.
    """

    def __init__(
        self,
        recorder: Recorder,
        rest: Floats,
        threshold: float,
        max_iterations: int,
        policy: DescentPolicy = POLICY.descent,
        *,
        rounding: float = 0.0,
    ):
        self._rounding = rounding
        self._recorder, self._rest, self._policy = recorder, rest, policy
        self.threshold, self._max_iterations = threshold, max_iterations
        self.iteration = -1
        self.forget()

    def forget(self):
        """Start anew to look for the best point: the lowest, and among those level with it the flattest."""
        self.best: Point | None = None
        self._best_at = self.iteration

    def record(self, point: Point) -> Reason | None:
        """Take note of an iteration, the start first; the reason to stop, if there is one."""
        self.iteration += 1
        norm = point.norm
        positions = self._rest + point.u if self._recorder.has_listener else point.u
        if self._recorder.record(positions, point.energy, norm):
            return Reason.INTERRUPTED
        if not np.isfinite(point.energy) or not np.isfinite(norm):
            return Reason.NOT_FINITE
        if norm <= self.threshold:
            return Reason.CONVERGED
        rounding = self._policy.rounding * abs(point.energy)
        if (
            self.best is None
            or point.energy < self.best.energy - rounding
            or (point.energy <= self.best.energy + rounding and norm < self.best.norm)
        ):
            self.best, self._best_at = point, self.iteration
        patience = self._policy.patience if norm > self._rounding else self._policy.patience_at_rounding
        if self.iteration - self._best_at >= patience:
            return Reason.STAGNATED
        return Reason.MAX_ITERATIONS if self.iteration >= self._max_iterations else None


class Untangling:
    """Shows a watch the true energy along a descent of another, and ends that once its gradient has become small."""

    def __init__(self, problem: Objective, watch: Watch):
        self._problem, self._watch = problem, watch
        self._first: float | None = None
        self._seen = 0
        self.stopped: Reason | None = None

    def record(self, point: Point) -> Reason | None:
        """Take note of a point of the other energy; the last one is left for the descent that follows to see."""
        self._first = point.norm if self._first is None else self._first
        self._seen += 1
        policy = self._problem.policy
        if point.norm <= policy.untangled * self._first or self._seen > policy.max_untangling:
            return Reason.CONVERGED
        self.stopped = self._watch.record(self._problem.at(point.place))
        return self.stopped

    def forget(self):
        self._watch.forget()


Descent = Callable[[Objective, Point, Observer], tuple[Point, Reason]]


def plain(problem: Objective, point: Point, watch: Observer) -> tuple[Point, Reason]:
    """Local projections and global solves in turn (Bouaziz et al. 2014); the energy never rises but by rounding.

    With bodies, whose turns the matrix does not bound, and energies that it does not, this takes a safeguard.
    """
    while (reason := watch.record(point)) is None:
        if len(point.place.rotations) or not problem.bounded:
            _, point = _safe_step(problem, point, problem.precondition(point.gradient, point))
        else:
            point = problem.after(point, -problem.precondition(point.gradient, point))
    return point, reason


def _safe_step(problem: Objective, point: Point, uphill: Floats) -> tuple[Floats, Point]:
    """The step against `uphill` = A⁻¹ ∇E, halved while the energy rises, and its end.

    Where A holds a share of what bounds the energy, a step of twice this share would lower it; the Hessian at another
    point, which may be all but singular, bounds nothing, and its step is halved until it does.
    """
    step = -uphill
    ahead = problem.after(point, step)
    for _ in range(problem.policy.safe_halvings):
        if ahead.energy <= point.energy + problem.policy.rounding * abs(point.energy):
            break
        step = 0.5 * step
        ahead = problem.after(point, step)
    return step, ahead


def after_untangling(
    descend: Descent, problem: Objective, point: Point, watch: Watch, *, untangle: Descent
) -> tuple[Point, Reason]:
    """A way down after another, `untangle`, on the untangling energy, where the start needs that.

    Stiff volumes have local minima among inverted tets; shape alone was never seen to stay in one.
    """
    if problem.untangling is not None:
        other = Untangling(problem, watch)
        end, _ = untangle(problem.untangling, problem.untangling.at(point.place), other)
        point = problem.at(end.place)
        if other.stopped is not None:
            return point, other.stopped
        watch.forget()
    return descend(problem, point, watch)


def anderson(problem: Objective, point: Point, watch: Observer) -> tuple[Point, Reason]:
    """Plain steps mixed with the last few (Anderson 1965; for projective dynamics Peng et al. 2018).

    Where the mixed step would raise the energy, the plain one is taken, and the history emptied.
    """
    mixed_steps = problem.policy.mixed
    steps: list[Floats] = []
    residuals: list[Floats] = []
    last: Floats | None = None
    while (reason := watch.record(point)) is None:
        residual = -problem.precondition(point.gradient, point)
        if last is not None:
            residuals.append(residual - last)
        mixed = _mix(residual, steps, residuals) if steps else None
        ahead = None if mixed is None else problem.after(point, mixed)
        if mixed is None or ahead is None or not ahead.energy <= point.energy:
            steps, residuals = [], []
            mixed, ahead = _safe_step(problem, point, -residual)
        steps.append(mixed)
        steps, residuals = steps[-mixed_steps:], residuals[1 - mixed_steps :]
        last, point = residual, ahead
    return point, reason


def _mix(residual: Floats, steps: list[Floats], residuals: list[Floats]) -> Floats:
    """The step f - Σ γ (s + Δf) whose γ makes |f - Σ γ Δf| least (Walker and Ni 2011, Eq. 2.2)."""
    changes = np.array(residuals)
    normal = changes @ changes.T
    normal[np.diag_indices_from(normal)] *= 1.0 + 1e-12
    weights = np.linalg.lstsq(normal, changes @ residual, rcond=None)[0]
    return residual - weights @ (np.array(steps) + changes)


def lbfgs(problem: Objective, point: Point, watch: Observer) -> tuple[Point, Reason]:
    """L-BFGS with the PD matrix as the initial Hessian (Liu, Bouaziz and Kavan 2017, Algorithm 1).

    Where no fraction of its step lowers the energy, one along -A⁻¹ ∇E is taken, and the memory emptied.
    """
    memory = Memory(len(point.gradient))
    while (reason := watch.record(point)) is None:
        point = lbfgs_step(problem, point, memory)
    return point, reason


def lbfgs_step(problem: Objective, point: Point, memory: Memory) -> Point:
    """Take one iteration of `lbfgs`, and add its pair to the memory."""
    taken = None
    if memory:
        direction = memory.direction(point.gradient, lambda vector: problem.precondition(vector, point))
        taken = search_line(problem, point, direction)
    if taken is None:
        memory.clear()
        taken = _safe_step(problem, point, problem.precondition(point.gradient, point))
    step, ahead = taken
    memory.add(step, ahead.gradient - point.gradient)
    return ahead


def search_line(
    problem: Objective, point: Point, direction: Floats, halvings: int | None = None
) -> tuple[Floats, Point] | None:
    """Return a step along a direction, halved until Armijo's condition holds, and its end; None if not soon.

    Where rounding hides the decrease, the slope is asked instead (Hager and Zhang 2005, Eq. 4.1).
    """
    slope = float(np.dot(point.gradient, direction))
    if not slope < 0.0:
        return None
    size, policy = 1.0, problem.policy
    for _ in range(policy.halvings if halvings is None else halvings):
        step = direction if size == 1.0 else size * direction
        ahead = problem.after(point, step)
        if ahead.energy <= point.energy + policy.armijo * size * slope:
            return step, ahead
        level = ahead.energy <= point.energy + policy.rounding * abs(point.energy)
        if level and float(np.dot(ahead.gradient, direction)) <= (2.0 * policy.armijo - 1.0) * slope:
            return step, ahead
        size *= 0.5
    return None
