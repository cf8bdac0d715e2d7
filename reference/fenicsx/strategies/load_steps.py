"""The strategy "load steps": Newton's method on the equations of equilibrium, for forces without an energy.

A step is damped until the simplified correction that follows it is shorter than the correction itself, a test that
does not depend on how forces, volumes and pressures are scaled (Deuflhard 2011, "Newton Methods for Nonlinear
Problems", Section 3.3). Where the whole load fails at once, it grows from the start in steps, halved where they fail.
"""

from __future__ import annotations

import numpy as np

from ....lhm.base.mesh import Floats
from ...restraint import has_free_motion
from ...solution import Reason
from ..dolfinx_version import PETSc
from ..linear.problem import DiscreteProblem
from ..linear.saddle import SaddleMatrix
from ..linear.solvers import Factorisation, hold, multiply, petsc_vector
from ..mesh.parallel import anywhere, norm
from ..policy import POLICY, FenicsxPolicy
from ..run import Attempt, Run
from .equilibrium import Equilibrium, Point

FAILED = (Reason.LINE_SEARCH, Reason.LINEAR_SOLVER, Reason.STAGNATED)
"""Reasons after which a shorter step is tried."""


class LoadSteps:
    """A run's load and motion on a problem; `saddle` is as of `Equilibrium`."""

    def __init__(
        self,
        run: Run,
        problem: DiscreteProblem,
        *,
        saddle: SaddleMatrix | None = None,
        policy: FenicsxPolicy = POLICY,
    ):
        self._policy = policy.load_steps
        self._run, self._problem = run, problem
        self._equations = Equilibrium(problem, problem.held_dofs(run.held), saddle)
        self._start, self._goal = (self._equations.vector(u, None) for u in (run.u, run.goal))
        self._drifts = has_free_motion(run.scene)
        self._limit = run.record.left(self._policy.max_iterations)
        self._factors = Factorisation(policy.linear)
        self._factored = self._iterations = 0

    def attempt(self) -> Attempt:
        """Take all of the load at once or, where that fails, in steps; give the last equilibrium."""
        point, reason = self._correct(self._start, 1.0)
        if reason in FAILED:
            point, reason = self._grow()
        self._run.record.add(self._iterations, linear_solves=self._factored)
        pressure = point.state.p if self._problem.mixed else None
        return Attempt(reason, self._run.numbering, point.state.u, pressure, point.state.energy)

    def _grow(self) -> tuple[Point, Reason]:
        """Let load and motion grow; give the last equilibrium, and why it is the last."""
        here, reason = self._correct(self._start, 0.0)
        step = self._policy.first_share
        while reason is Reason.CONVERGED and here.share < 1.0:
            after, reason = self._correct(here.z, min(1.0, here.share + step))
            if reason is Reason.CONVERGED:
                here = after
            elif reason in FAILED and step > self._policy.smallest_share:
                step, reason = 0.5 * step, Reason.CONVERGED
        return here, reason

    def _correct(self, z: Floats, share: float) -> tuple[Point, Reason]:
        """Newton's method from z at a share of load and motion."""
        equations, held = self._equations, self._equations.held
        target = (self._start + share * (self._goal - self._start))[held]
        point = equations.at(z, share)
        if not point.finite:
            self._run.report(point.state.u, point.state.energy, np.inf)
            return point, Reason.NOT_FINITE
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
                last = self._run.threshold(max(norm, equations.norm(self._free(point.residual))))
                if share < 1.0:  # on the way, what rounding leaves does
                    last = max(last, self._run.scene.rounding())
            if self._run.report(point.state.u, point.state.energy, norm):
                return point, Reason.INTERRUPTED
            if norm <= last and not moves:
                return point, Reason.CONVERGED
            if not self._factor(derivative):
                return point, Reason.LINEAR_SOLVER
            if self._iterations >= self._limit:
                return point, Reason.MAX_ITERATIONS
            self._iterations += 1
            correction = jump - self._factors.solve(forces)
            following = self._damp(point, correction, min(1.0, 2.0 * damping))
            if following is None:
                return point, Reason.STAGNATED if norm <= 1e3 * last and not moves else Reason.LINE_SEARCH
            point, damping = following
        return point, Reason.LINE_SEARCH

    def _factor(self, derivative: PETSc.Mat) -> bool:
        """Factor a derivative whose held unknowns are left out, which it loses."""
        equations = self._equations
        self._factored += 1
        if self._drifts:
            trace = np.zeros(equations.count)
            free = np.setdiff1d(np.arange(equations.displacements), equations.held)
            trace[free] = self._policy.drift * derivative.getDiagonal().norm(PETSc.NormType.INFINITY)
            added = petsc_vector(trace, derivative.comm, derivative.getBlockSize())
            derivative.setDiagonal(added, addv=PETSc.InsertMode.ADD_VALUES)
        hold(derivative, equations.held, np.zeros(len(equations.held)), np.zeros(equations.count))
        return self._factors.factor(derivative, symmetric=equations.symmetric)

    def _damp(self, point: Point, correction: Floats, damping: float) -> tuple[Point, float] | None:
        """The point after as much of a correction as the one that would follow allows, and how much that is."""
        equations = self._equations
        length = self._length(self._free(correction))
        size = 1e-14 * self._length(point.z + 1e-300)
        while damping >= self._policy.smallest_damping:
            z = point.z + damping * correction
            if damping == 1.0:
                z[equations.held] = point.z[equations.held] + correction[equations.held]
            after = equations.at(z, point.share)
            if after.finite:
                simplified = self._factors.solve(self._free(after.residual))
                if self._length(simplified) <= (1.0 - damping / 4.0) * length + size:
                    return after, damping
            damping *= 0.5
        return None

    def _free(self, z: Floats) -> Floats:
        """A vector without what is held."""
        result = np.array(z)
        result[self._equations.held] = 0.0
        return result

    def _length(self, z: Floats) -> float:
        """The norm of the displacements of a vector [mm]."""
        return norm(self._equations.comm, z[: self._equations.displacements])
