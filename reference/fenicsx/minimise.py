"""The strategy "minimise": Newton's method on the energy, in as few load steps as keep it finite."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from ...lhm.base.mesh import Floats
from ..restraint import has_free_motion
from ..solution import Limits, Reason
from ..terms import Bending, RigidBody, Strain, SurfaceStrain, Traction, Volume
from .bodies import Pose, RigidProblem
from .linear import LinearSolver
from .load_path import DRIFT, PATH_TOLERANCE
from .newton import AnyState, Newton, Work
from .problem import Problem, State
from .run import Attempt, Run

MAX_ITERATIONS = 100
LOAD_STEP_TOLERANCE = 1e-2
STRAIGHT_ITERATIONS = 10  # beyond them descent may have left the path that the load grows along
ROUNDING = 1e-14  # of the largest coordinate: closer to its goal, what is held has arrived
# Terms whose energy may lose stiffness in directions that cost nothing, and those that the load path has no room for.
INDEFINITE = (Strain, Volume, SurfaceStrain, Bending, RigidBody)


class Minimisation:
    """From a run's start towards what is held.

    `linear` and `direct` are the usual linear solver of the problem's matrix and the one that it falls back to, `rigid`
    the problem with bodies and its two. Bodies are brought to their first `poses` like held vertices, and set free once
    all that is held is in place.
    """

    def __init__(
        self,
        run: Run,
        problem: Problem,
        linear: LinearSolver,
        direct: LinearSolver,
        rigid: tuple[RigidProblem, LinearSolver, LinearSolver] | None = None,
        poses: list[Pose] | None = None,
    ):
        self._run, self._problem, self._nodes = run, problem, run.numbering.nodes
        self._poses = poses or []
        self._goal = np.array(run.goal)
        held = run.held | problem.unsupported[:, None]
        self._assemblies = problem.assemblies
        self._work = Work()
        self._rigid: RigidProblem | None = None
        if rigid is not None:
            self._rigid = rigid[0]
            self._freed = Newton(*rigid[:1], rigid[0].held(held), *rigid[1:], self._report, self._work)
            held[rigid[0].nodes] = True
            places = run.numbering.X + self._goal
            rigid[0].place(self._poses, places)
            self._goal[rigid[0].nodes] = (places - run.numbering.X)[rigid[0].nodes]
            self._goal = self._nodes.spread(self._own(self._goal))
        near = np.abs(self._goal - run.u) <= ROUNDING * np.abs(run.scene.vertices).max(initial=1.0)
        self._goal[near] = run.u[near]
        self._newton = Newton(problem, np.flatnonzero(self._own(held)), linear, direct, self._report, self._work)

    def attempt(self) -> Attempt:
        """Minimise.

        A body of elastic tissue alone, pulled at its surface, may be in equilibrium and yet unstable, or have snapped.
        """
        before = self._run.record.iterations
        state, reason = self._descend()
        end = Attempt(reason, self._run.numbering, state.u, None, state.energy, sound=False)
        scene = self._run.scene
        if reason is Reason.CONVERGED:
            end = replace(end, sound=True)
            if scene.of(Traction) and not any(scene.of(kind) for kind in INDEFINITE):
                stable = self._newton.stable(self._at(state.u), DRIFT if has_free_motion(scene) else 0.0)
                many = self._run.record.iterations - before > STRAIGHT_ITERATIONS
                end = replace(end, sound=stable, doubtful=many or not stable)
        work = self._work
        self._run.record.add(
            0,
            linear_iterations=work.linear_iterations,
            linear_solves=work.linear_solves,
            fallback_solves=work.fallback_solves,
            assemblies=self._problem.assemblies - self._assemblies,
            energies=work.energies,
        )
        return end

    def settle(self, u: Floats, p: Floats, share: float) -> tuple[Floats, Floats, Reason, int]:
        """See `load_path.Descent`: what is held stays where it is."""
        state = self._at(u, share)
        if not np.isfinite(state.energy):
            return u, p, Reason.NOT_FINITE, 0
        end, reason, made = self._newton.minimise(
            state, threshold=lambda first: PATH_TOLERANCE * first, max_iterations=self._run.record.left(MAX_ITERATIONS)
        )
        return end.u, p, reason, made

    def _own(self, field):
        """The vector of a field: see `shared`."""
        return field[: self._nodes.owned]

    def _at(self, u: Floats, share: float = 1.0) -> State:
        self._work.energies += 1
        return self._problem.at(u, share=share)

    def _report(self, state: AnyState, norm: float) -> bool:
        return self._run.tell(state.u, state.energy, norm)

    def _descend(self) -> tuple[AnyState, Reason]:
        """Lift, take load steps if need be, and minimise."""
        run = self._run
        left = run.record.left(MAX_ITERATIONS)
        state = self._at(run.u)
        if not np.isfinite(state.energy):
            self._report(state, np.inf)
            return state, Reason.NOT_FINITE
        while True:
            lifted, fraction, force = self._newton.lift(state, self._goal, self._nodes, self._at)
            if lifted is None:
                return state, Reason.LINE_SEARCH
            limits = run.limits if fraction == 1.0 else Limits(LOAD_STEP_TOLERANCE)

            def threshold(first: float, force: float = force, limits: Limits = limits) -> float:
                return limits.threshold(run.scene, max(first, force))

            newton, begin = self._newton, lifted
            if fraction == 1.0 and self._rigid is not None:
                newton, begin = self._freed, self._rigid.at(lifted.u, self._poses)
            end, reason, made = newton.minimise(begin, threshold=threshold, max_iterations=left)
            left -= made
            run.record.add(made)
            if fraction == 1.0 or reason is not Reason.CONVERGED:
                return end, reason
            state = cast(State, end)
