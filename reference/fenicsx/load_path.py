"""Newton's method on the equations of equilibrium, and the path of equilibria that loads and motions grow along.

A step is damped until the simplified correction that follows it is shorter than the correction itself, a test that
does not depend on how forces, volumes and pressures are scaled (Deuflhard 2011, "Newton Methods for Nonlinear
Problems", Section 3.3). Where the whole load fails at once, it grows in steps of adaptive size from the start. Where
steps get small, descent may show that a part of the body snaps, such as an element beside a clamp, and the path goes
on behind it; what takes the body elsewhere is another answer, and no continuation. Where steps shrink to nothing, the
last equilibrium tells why: near a limit point the displacement grows without bound with the load, or the tangent turns
indefinite; else the steps, not the load, are at fault.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...lhm.mesh import Floats
from ..solution import Reason
from .direct import Factorisation
from .dolfinx_version import PETSc
from .equilibrium import Equilibrium, Point
from .linear import hold, product, vector
from .shared import anywhere, largest, norm

SMALLEST_DAMPING = 1 / 32
STEP_ITERATIONS = 25
FIRST_SHARE = 1 / 4
SMALLEST_SHARE = 1 / 1024
SNAP_SHARE = 1 / 64  # the step at which descent is asked
SNAP = 0.2  # of the displacement so far, that a snap may add to it at most
ASIDE, MODE_ITERATIONS = 1e-3, 5  # of the largest displacement, to leave an unstable equilibrium by
EASY = 5  # iterations, within which the next load step may be longer
PATH_TOLERANCE = 1e-6
DRIFT = 1e-9  # of the tangent's largest entry
STEEP = 4.0  # times the first rate of displacement by load, that tells a limit point


@dataclass(frozen=True, eq=False)
class Equilibrated:
    """A point of the path, whether Newton got there, its iterations, and whether the tangent there is stable."""

    point: Point
    reason: Reason
    iterations: int
    stable: bool

    @property
    def converged(self) -> bool:
        """Whether it is an equilibrium."""
        return self.reason is Reason.CONVERGED


@dataclass(eq=False)
class LoadPath:
    """Equations, where held unknowns go, a vector, and who is told of each iteration and may stop.

    A body that `drifts` has rigid motions left; a trace of stiffness keeps its tangent regular. `descend` goes from
    unknowns to a minimum of the energy at a share of the loads, and gives it, why it stopped, and its iterations.
    """

    equations: Equilibrium
    start: Floats
    goal: Floats
    threshold: Callable[[float], float]
    report: Callable[[Point, float], bool]
    max_iterations: int
    drifts: bool = False
    descend: Callable[[Floats, float], tuple[Floats, Reason, int]] | None = None
    factors: Factorisation = field(default_factory=Factorisation)
    factored: int = 0
    iterations: int = 0
    share: float = 0.0
    _first: float = 0.0
    _unstable: bool = False
    _origin: Floats = field(default_factory=lambda: np.zeros(0))

    def run(self) -> tuple[Point, Reason]:
        """All of the load at once or, where that fails or ends unstable, in steps; the last equilibrium and why."""
        begin = self.equations.at(self.start, 0.0)
        if not begin.finite:
            self.report(begin, np.inf)
            return begin, Reason.NOT_FINITE
        whole = self._correct(self.start, 1.0, final=True)
        if whole.converged and whole.stable:
            self.share = 1.0
            return whole.point, Reason.CONVERGED
        if whole.reason in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS, Reason.STAGNATED):
            return whole.point, whole.reason
        return self._grow()

    def _grow(self) -> tuple[Point, Reason]:
        """Follow the path from the start."""
        first = self._correct(self.start, 0.0)
        if not first.converged:
            return first.point, first.reason
        here = first.point
        self._origin = here.z
        first_rate = self._rate(here)
        before: Point | None = None
        step = FIRST_SHARE
        self._unstable = False
        while here.share < 1.0:
            share = min(1.0, here.share + step)
            after = self._correct(self._predicted(before, here, share), share, final=share == 1.0)
            if after.reason in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS):
                return here, after.reason
            if after.converged and after.stable:
                before, here, self.share = here, after.point, share
                step *= 2.0 if after.iterations <= EASY else 1.0
                continue
            self._unstable |= after.converged
            step *= 0.5
            if step == SNAP_SHARE and self.descend is not None:
                share = min(1.0, here.share + step)
                after = self._snapped(self._predicted(before, here, share), here, share)
                if after.reason in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS):
                    return here, after.reason
                if after.converged and after.stable:
                    before, here, self.share = None, after.point, share
                    step *= 2.0
                    continue
            if step < SMALLEST_SHARE:
                steep = self._rate(here) > STEEP * first_rate
                return here, Reason.LIMIT_POINT if self._unstable or steep else Reason.LINE_SEARCH
        return here, Reason.CONVERGED

    def _aside(self, saddle: Point) -> Floats:
        """Unknowns beside an unstable equilibrium, whose tangent is factored, where the tangent is softest."""
        equations = self.equations
        mode = self._free(equations.irregular())
        for _ in range(MODE_ITERATIONS):
            mode = self.factors.solve(mode)
            mode /= largest(equations.comm, mode)
        mode[equations.held] = 0.0
        in_space = slice(0, equations.displacements)
        return saddle.z + ASIDE * largest(equations.comm, (saddle.z - self._origin)[in_space]) * mode

    def _snapped(self, guess: Floats, here: Point, share: float) -> Equilibrated:
        """The stable equilibrium at a share to which descent leads from an unstable one or a guess, if that is near."""
        equations, final = self.equations, share == 1.0
        assert self.descend is not None
        unstable = self._correct(guess, share, final=final)
        if unstable.reason in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS) or unstable.stable:
            return unstable
        begin = self._aside(unstable.point) if unstable.converged else guess.copy()
        begin[equations.held] = self._at_share(share)[equations.held]
        down, reason, made = self.descend(begin, share)
        self.iterations += made
        if reason is Reason.INTERRUPTED:
            return Equilibrated(here, reason, made, False)
        far = self._length(down - begin) > SNAP * self._length(here.z - self._origin)
        if far or reason not in (Reason.CONVERGED, Reason.STAGNATED):
            return Equilibrated(here, Reason.LIMIT_POINT, made, False)
        return self._correct(down, share, final=final)

    def _predicted(self, before: Point | None, here: Point, share: float) -> Floats:
        if before is None:
            return here.z
        guess = here.z + (share - here.share) / (here.share - before.share) * (here.z - before.z)
        return guess if self.equations.at(guess, share).finite else here.z

    def _at_share(self, share: float) -> Floats:
        return self.start + share * (self.goal - self.start)

    def _rate(self, point: Point) -> float:
        """The norm of the displacement's change by the share of load and motion [mm]."""
        equations = self.equations
        derivative = equations.derivative(point)
        motion = np.zeros(equations.count)
        motion[equations.held] = (self.goal - self.start)[equations.held]
        forces = equations.by_share(point) + product(derivative, motion)
        if not self._factor(derivative):
            return np.inf
        forces[equations.held] = 0.0
        return self._length(motion - self.factors.solve(forces))

    def _length(self, z: Floats) -> float:
        """The norm of the displacements of a vector [mm]."""
        return norm(self.equations.comm, z[: self.equations.displacements])

    def _factor(self, derivative: PETSc.Mat) -> bool:
        """Factor a derivative whose held unknowns are left out, which it loses."""
        equations = self.equations
        self.factored += 1
        if self.drifts:
            trace = np.zeros(equations.count)
            free = equations.free[equations.free < equations.displacements]
            trace[free] = DRIFT * derivative.getDiagonal().norm(PETSc.NormType.INFINITY)
            added = vector(trace, derivative.comm, derivative.getBlockSize())
            derivative.setDiagonal(added, addv=PETSc.InsertMode.ADD_VALUES)
        hold(derivative, equations.held, np.zeros(len(equations.held)), np.zeros(equations.count))
        return self.factors.factor(derivative, symmetric=equations.symmetric)

    @property
    def _stable(self) -> bool:
        """Whether the last factored tangent has no more negative directions than the pressures bring."""
        expected = self.equations.free_pressures
        return self.factors.negative == (expected if self.factors.symmetric else expected % 2)

    def _correct(self, z: Floats, share: float, *, final: bool = False) -> Equilibrated:
        """Newton's method from z at a share of load and motion."""
        equations = self.equations
        held = equations.held
        target = self._at_share(share)[held]
        point = equations.at(z, share)
        damping, last = 1.0, 0.0
        for iteration in range(STEP_ITERATIONS + 1):
            derivative = equations.derivative(point)
            if iteration == 0:
                equations.scale_volumes(derivative)
            jump = np.zeros(equations.count)
            jump[held] = target - point.z[held]
            moves = anywhere(equations.comm, jump)
            forces = self._free(point.residual + product(derivative, jump))
            norm = equations.norm(forces)
            if iteration == 0:
                first = max(norm, equations.norm(self._free(point.residual)))
                if final and self._first == 0.0:
                    self._first = first
                last = self.threshold(self._first) if final else max(PATH_TOLERANCE * first, self.threshold(first))
            if self.report(point, norm):
                return Equilibrated(point, Reason.INTERRUPTED, iteration, False)
            regular = self._factor(derivative)
            if norm <= last and not moves:
                return Equilibrated(point, Reason.CONVERGED, iteration, regular and self._stable)
            if not regular:
                return Equilibrated(point, Reason.LINEAR_SOLVER, iteration, False)
            if self.iterations >= self.max_iterations:
                return Equilibrated(point, Reason.MAX_ITERATIONS, iteration, False)
            self.iterations += 1
            correction = jump - self.factors.solve(forces)
            damping = min(1.0, 2.0 * damping)
            following = self._damped(point, correction, damping)
            if following is None:
                stagnated = norm <= 1e3 * last and not moves
                return Equilibrated(point, Reason.STAGNATED if stagnated else Reason.LINE_SEARCH, iteration, False)
            point, damping = following
        return Equilibrated(point, Reason.LINE_SEARCH, STEP_ITERATIONS, False)

    def _free(self, z: Floats) -> Floats:
        """A vector without what is held."""
        result = np.array(z)
        result[self.equations.held] = 0.0
        return result

    def _damped(self, point: Point, correction: Floats, damping: float) -> tuple[Point, float] | None:
        """The point after as much of a correction as the one that would follow allows, and how much that is."""
        equations = self.equations
        length = self._length(self._free(correction))
        size = 1e-14 * self._length(point.z + 1e-300)
        while damping >= SMALLEST_DAMPING:
            z = point.z + damping * correction
            if damping == 1.0:
                z[equations.held] = point.z[equations.held] + correction[equations.held]
            after = equations.at(z, point.share)
            if after.finite:
                simplified = self.factors.solve(self._free(after.residual))
                if self._length(simplified) <= (1.0 - damping / 4.0) * length + size:
                    return after, damping
            damping *= 0.5
        return None
