"""The strategy "minimise": Newton's method on the energy, in as few load steps as keep it finite."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats
from ..restraint import has_free_motion
from ..solution import Limits, Reason
from ..terms import Traction
from .bodies import RigidProblem
from .linear_solvers import LinearSolver
from .load_path import DRIFT, PATH_TOLERANCE
from .newton import AnyState, Newton, Work
from .problem import Problem, State
from .run import Attempt, Run

MAX_ITERATIONS = 100
LOAD_STEP_TOLERANCE = 1e-2
STRAIGHT_ITERATIONS = 10  # beyond them descent may have left the path that the load grows along
ROUNDING = 1e-14  # of the largest coordinate: closer to its goal, what is held has arrived


class Minimisation:
    """From a run's start towards what is held.

    `linear` and `direct` are the usual linear solver of the problem's matrix and the one that it falls back to, `rigid`
    the problem with bodies and its two. Bodies are brought to their first poses like held vertices, and set free once
    all that is held is in place.
    """

    def __init__(
        self,
        run: Run,
        problem: Problem,
        linear: LinearSolver,
        direct: LinearSolver,
        rigid: tuple[RigidProblem, LinearSolver, LinearSolver] | None = None,
    ):
        self._run, self._problem, self._nodes = run, problem, run.numbering.nodes
        owned, X = self._nodes.owned, run.numbering.X
        self._work = Work()
        self._goal = np.array(run.goal)
        held = run.held | problem.unsupported[:, None]
        self._rigid: RigidProblem | None = None
        if rigid is not None:
            self._rigid = bodies = rigid[0]
            bodies.set(run.scene)
            self._poses = bodies.nearest(run.numbering.to_dofs(run.start)) if run.warm else bodies.rest()
            self._freed = Newton(bodies, bodies.held(held), *rigid[1:], self._report, self._work)
            held[bodies.nodes] = True
            places = X + self._goal
            bodies.place(self._poses, places)
            self._goal[bodies.nodes] = (places - X)[bodies.nodes]
            self._goal = self._nodes.spread(self._goal[:owned])
        near = np.abs(self._goal - run.u) <= ROUNDING * np.abs(run.scene.vertices).max(initial=1.0)
        self._goal[near] = run.u[near]
        self._newton = Newton(problem, np.flatnonzero(held[:owned]), linear, direct, self._report, self._work)

    def attempt(self) -> Attempt:
        """Bring what is held to its goal, in load steps if need be, and minimise.

        A body of elastic tissue alone, pulled at its surface, may be in equilibrium and yet unstable, or have snapped.
        """
        run, loose = self._run, Limits(LOAD_STEP_TOLERANCE)
        left = run.record.left(MAX_ITERATIONS)

        def end_step(force: float, first: float) -> float:
            return loose.threshold(run.scene, max(first, force))

        state, force, reason, iterations = self._newton.approach(
            self._at(run.u), self._goal, self._nodes, self._at, threshold=end_step, max_iterations=left
        )
        if reason is None:
            newton = self._newton
            if self._rigid is not None:
                newton, state = self._freed, self._rigid.at(state.u, self._poses)
            state, reason, more = newton.minimise(
                state, threshold=lambda first: run.threshold(max(first, force)), max_iterations=left - iterations
            )
            iterations += more
        sound, doubtful = reason is Reason.CONVERGED, False
        if sound and run.scene.of(Traction) and not any(term.may_soften for term in run.scene.terms):
            drift = DRIFT if has_free_motion(run.scene) else 0.0
            sound = self._newton.is_stable(self._at(state.u), drift)
            doubtful = iterations > STRAIGHT_ITERATIONS or not sound
        run.record.add(iterations, **vars(self._work))
        return Attempt(reason, run.numbering, state.u, None, state.energy, sound=sound, doubtful=doubtful)

    def settle(self, u: Floats, p: Floats, share: float) -> tuple[Floats, Floats, Reason, int]:
        """See `load_path.Descent`: what is held stays where it is."""
        state = self._at(u, share)
        if not np.isfinite(state.energy):
            return u, p, Reason.NOT_FINITE, 0
        end, reason, made = self._newton.minimise(
            state, threshold=lambda first: PATH_TOLERANCE * first, max_iterations=self._run.record.left(MAX_ITERATIONS)
        )
        return end.u, p, reason, made

    def _at(self, u: Floats, share: float = 1.0) -> State:
        self._work.energies += 1
        return self._problem.at(u, share=share)

    def _report(self, state: AnyState, norm: float) -> bool:
        return self._run.report(state.u, state.energy, norm)
