"""The strategy "continuation": Newton's method on the equations of equilibrium, along the path that loads grow along.

A step is damped until the simplified correction that follows it is shorter than the correction itself, a test that
does not depend on how forces, volumes and pressures are scaled (Deuflhard 2011, "Newton Methods for Nonlinear
Problems", Section 3.3). Where the whole load fails at once, it grows in steps of adaptive size from the start. Where
steps get small, descent may show that a part of the body snaps, such as an element beside a clamp, and the path goes
on behind it; what takes the body elsewhere is another answer, and no continuation, unless it comes as near as the load
to where the body lost its stability, as a column's bent shapes do: there the path branches off. Where steps shrink to
nothing, the last equilibrium tells why: near a limit point the displacement grows without bound with the load, or the
tangent turns indefinite; else the steps, not the load, are at fault.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ....lhm.base.mesh import Floats
from ...restraint import has_free_motion
from ...solution import Reason
from ..dolfinx_version import PETSc
from ..linear.problem import Problem
from ..linear.saddle import SaddleMatrix
from ..linear.solvers import Factorisation, hold, multiply, petsc_vector
from ..mesh.parallel import anywhere, largest_size, norm
from ..policy import POLICY, FenicsxPolicy
from ..run import Attempt, Run
from .equilibrium import Equilibrium, Point

Descent = Callable[[Floats, Floats, float], tuple[Floats, Floats, Reason, int]]
"""Minimises a problem's energy at a share of its loads from displacement, a field (n, 3), and pressure, a vector, to
both; why it stopped; iterations."""


@dataclass(frozen=True, eq=False)
class PathStep:
    """A point of the path, whether Newton got there, its iterations, and whether the tangent there is stable."""

    point: Point
    reason: Reason
    iterations: int
    stable: bool

    @property
    def converged(self) -> bool:
        """Whether it is an equilibrium."""
        return self.reason is Reason.CONVERGED


class Continuation:
    """A run's load path on a problem; `descent` is asked where a part of the body may have snapped.

    `saddle` is as of `Equilibrium`.
    """

    def __init__(
        self,
        run: Run,
        problem: Problem,
        descent: Descent | None = None,
        *,
        saddle: SaddleMatrix | None = None,
        policy: FenicsxPolicy = POLICY,
    ):
        self._policy = policy.load_path
        self._run, self._problem, self._descent = run, problem, descent
        self.equations = Equilibrium(problem, problem.held_dofs(run.held), saddle)
        self.start, self.goal = (self.equations.vector(u, None) for u in (run.u, run.goal))
        self._drifts = has_free_motion(run.scene)
        self._limit = run.record.left(self._policy.max_iterations)
        self.factors = Factorisation(policy.linear)
        self._factored = self._iterations = 0
        self._share = self._first = self._away = 0.0
        self._unstable = self._branched = False
        self._origin: Floats = np.zeros(0)

    def attempt(self) -> Attempt:
        """Take all of the load at once or, where that fails or ends unstable, in steps; give the last equilibrium."""
        point, reason = self.equations.at(self.start, 0.0), Reason.NOT_FINITE
        if not point.finite:
            self._report(point, np.inf)
        else:
            whole = self._correct(self.start, 1.0, final=True)
            point, reason = whole.point, whole.reason
            if whole.converged and whole.stable:
                self._share = 1.0
            elif reason not in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS, Reason.STAGNATED):
                point, reason = self._grow()
        record = self._run.record
        record.add(self._iterations, linear_solves=self._factored)
        record.detail["load_share"] = self._share  # type: ignore[assignment]
        pressure = point.state.p if self._problem.mixed else None
        return Attempt(reason, self._run.numbering, point.state.u, pressure, point.state.energy)

    def _report(self, point: Point, norm: float) -> bool:
        return self._run.report(point.state.u, point.state.energy, norm)

    def _grow(self) -> tuple[Point, Reason]:
        """Follow the path from the start in steps; give the last equilibrium and why it ends there."""
        first = self._correct(self.start, 0.0)
        if not first.converged:
            return first.point, first.reason
        here = first.point
        self._origin = here.z
        first_rate = self._rate(here)
        before: Point | None = None
        step = self._policy.first_share
        self._unstable = self._branched = False
        while here.share < 1.0:
            share = min(1.0, here.share + step)
            after = self._correct(self._predict(before, here, share), share, final=share == 1.0)
            if after.reason in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS):
                return here, after.reason
            if after.converged and after.stable:
                before, here, self._share = here, after.point, share
                step *= 2.0 if after.iterations <= self._policy.easy else 1.0
                continue
            self._unstable |= after.converged
            step *= 0.5
            if step in (self._policy.snap_share, self._policy.smallest_share) and self._descent is not None:
                share = min(1.0, here.share + step)
                after = self._snap(self._predict(before, here, share), here, share)
                if after.reason in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS):
                    return here, after.reason
                if after.converged and after.stable:
                    before, here, self._share = None, after.point, share
                    step *= 2.0
                    continue
            if step < self._policy.smallest_share:
                if self._branched:
                    return here, Reason.BIFURCATION
                steep = self._rate(here) > self._policy.steep * first_rate
                return here, Reason.LIMIT_POINT if self._unstable or steep else Reason.LINE_SEARCH
        return here, Reason.CONVERGED

    def _aside(self, saddle: Point) -> Floats:
        """Unknowns beside an unstable equilibrium, whose tangent is factored, where the tangent is softest."""
        equations = self.equations
        mode = self._free(equations.irregular())
        for _ in range(self._policy.mode_iterations):
            mode = self.factors.solve(mode)
            mode /= largest_size(equations.comm, mode)
        mode[equations.held] = 0.0
        in_space = slice(0, equations.displacements)
        return saddle.z + self._policy.aside * largest_size(equations.comm, (saddle.z - self._origin)[in_space]) * mode

    def _snap(self, guess: Floats, here: Point, share: float) -> PathStep:
        """The stable equilibrium at a share to which descent leads from an unstable one or a guess, if that is near."""
        equations, final = self.equations, share == 1.0
        unstable = self._correct(guess, share, final=final)
        if unstable.reason in (Reason.INTERRUPTED, Reason.MAX_ITERATIONS) or unstable.stable:
            return unstable
        begin = self._aside(unstable.point) if unstable.converged else guess.copy()
        begin[equations.held] = self._evaluate_share(share)[equations.held]
        assert self._descent is not None
        m = equations.displacements
        u, p, reason, made = self._descent(equations.fields(begin)[0], begin[m:], share)
        down = equations.vector(u, p)
        self._iterations += made
        if reason is Reason.INTERRUPTED:
            return PathStep(here, reason, made, False)
        away = min(self._length(down - begin), self._length(down - here.z))
        far = away > self._policy.snap * self._length(here.z - self._origin)
        branches = away <= self._policy.branch * self._away
        self._away = max(self._away, away)
        if (far and not branches) or reason not in (Reason.CONVERGED, Reason.STAGNATED):
            return PathStep(here, Reason.LIMIT_POINT, made, False)
        after = self._correct(down, share, final=final)
        self._branched |= far and after.converged and after.stable
        return after

    def _predict(self, before: Point | None, here: Point, share: float) -> Floats:
        if before is None:
            return here.z
        guess = here.z + (share - here.share) / (here.share - before.share) * (here.z - before.z)
        return guess if self.equations.at(guess, share).finite else here.z

    def _evaluate_share(self, share: float) -> Floats:
        return self.start + share * (self.goal - self.start)

    def _rate(self, point: Point) -> float:
        """The norm of the displacement's change by the share of load and motion [mm]."""
        equations = self.equations
        derivative = equations.derivative(point)
        motion = np.zeros(equations.count)
        motion[equations.held] = (self.goal - self.start)[equations.held]
        forces = equations.by_share(point) + multiply(derivative, motion)
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
        self._factored += 1
        if self._drifts:
            trace = np.zeros(equations.count)
            free = equations.free[equations.free < equations.displacements]
            trace[free] = self._policy.drift * derivative.getDiagonal().norm(PETSc.NormType.INFINITY)
            added = petsc_vector(trace, derivative.comm, derivative.getBlockSize())
            derivative.setDiagonal(added, addv=PETSc.InsertMode.ADD_VALUES)
        hold(derivative, equations.held, np.zeros(len(equations.held)), np.zeros(equations.count))
        return self.factors.factor(derivative, symmetric=equations.symmetric)

    def _correct(self, z: Floats, share: float, *, final: bool = False) -> PathStep:
        """Newton's method from z at a share of load and motion."""
        equations = self.equations
        held = equations.held
        target = self._evaluate_share(share)[held]
        point = equations.at(z, share)
        damping, last = 1.0, 0.0
        for iteration in range(self._policy.step_iterations + 1):
            derivative = equations.derivative(point)
            if iteration == 0:
                equations.scale_volumes(derivative)
            jump = np.zeros(equations.count)
            jump[held] = target - point.z[held]
            moves = anywhere(equations.comm, jump)
            forces = self._free(point.residual + multiply(derivative, jump))
            norm = equations.norm(forces)
            if iteration == 0:
                first = max(norm, equations.norm(self._free(point.residual)))
                if final and self._first == 0.0:
                    self._first = first
                last = (
                    self._run.threshold(self._first)
                    if final
                    else max(self._policy.tolerance * first, self._run.threshold(first))
                )
            if self._report(point, norm):
                return PathStep(point, Reason.INTERRUPTED, iteration, False)
            regular = self._factor(derivative)
            if norm <= last and not moves:
                # Pressures bring negative directions; a tangent without symmetry tells whether there are evenly many.
                expected = equations.free_pressures if self.factors.symmetric else equations.free_pressures % 2
                stable = regular and self.factors.negative == expected
                return PathStep(point, Reason.CONVERGED, iteration, stable)
            if not regular:
                return PathStep(point, Reason.LINEAR_SOLVER, iteration, False)
            if self._iterations >= self._limit:
                return PathStep(point, Reason.MAX_ITERATIONS, iteration, False)
            self._iterations += 1
            correction = jump - self.factors.solve(forces)
            damping = min(1.0, 2.0 * damping)
            following = self._damp(point, correction, damping)
            if following is None:
                stagnated = norm <= 1e3 * last and not moves
                return PathStep(point, Reason.STAGNATED if stagnated else Reason.LINE_SEARCH, iteration, False)
            point, damping = following
        return PathStep(point, Reason.LINE_SEARCH, self._policy.step_iterations, False)

    def _free(self, z: Floats) -> Floats:
        """A vector without what is held."""
        result = np.array(z)
        result[self.equations.held] = 0.0
        return result

    def _damp(self, point: Point, correction: Floats, damping: float) -> tuple[Point, float] | None:
        """The point after as much of a correction as the one that would follow allows, and how much that is."""
        equations = self.equations
        length = self._length(self._free(correction))
        size = 1e-14 * self._length(point.z + 1e-300)
        while damping >= self._policy.smallest_damping:
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
