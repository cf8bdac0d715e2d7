"""The strategy "minimise": Newton's method on the energy, in as few load steps as keep it finite."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....lhm.base.mesh import Floats
from ...restraint import has_free_motion
from ...solution import Limits, Reason
from ...terms import Traction
from ..linear.problem import DiscreteProblem, Evaluation
from ..linear.solvers import LinearSolver
from ..mesh.parallel import irregular_vector, largest_size
from ..policy import POLICY, FenicsxPolicy
from ..run import Attempt, Run
from .bodies import RigidProblem
from .newton import AnyState, Newton, Work


class Minimisation:
    """Minimise the energy from a run's start while held places are brought to their values.

    `linear` and `direct` are the usual linear solver of the problem's matrix and the one that it falls back to, `rigid`
    the problem with bodies and its two. Bodies are brought to their first poses like held vertices, and set free once
    all that is held is in place.
    """

    def __init__(
        self,
        run: Run,
        problem: DiscreteProblem,
        linear: LinearSolver,
        direct: LinearSolver,
        rigid: tuple[RigidProblem, LinearSolver, LinearSolver] | None = None,
        policy: FenicsxPolicy = POLICY,
    ):
        self._policy = policy
        self._run, self._problem, self._nodes = run, problem, run.numbering.nodes
        self._can_factor = linear is direct or 3 * self._nodes.total < policy.large_stiff
        owned, X = self._nodes.owned, run.numbering.X
        self._work = Work()
        self._goal = np.array(run.goal)
        held = run.held | problem.unsupported[:, None]
        self._rigid: RigidProblem | None = None
        if rigid is not None:
            self._rigid = bodies = rigid[0]
            bodies.set(run.scene)
            self._poses = bodies.nearest(run.numbering.to_dofs(run.start)) if run.is_given else bodies.rest()
            self._freed = Newton(bodies, bodies.held(held), *rigid[1:], self._report, self._work, policy.newton)
            held[bodies.nodes] = True
            places = X + self._goal
            bodies.place(self._poses, places)
            self._goal[bodies.nodes] = (places - X)[bodies.nodes]
            self._goal = self._nodes.spread(self._goal[:owned])
        rounding = policy.minimise.rounding * np.abs(run.scene.vertices).max(initial=1.0)
        near = np.abs(self._goal - run.u) <= rounding
        self._goal[near] = run.u[near]
        held_dofs = np.flatnonzero(held[:owned])
        self._newton = Newton(problem, held_dofs, linear, direct, self._report, self._work, policy.newton)

    def attempt(self) -> Attempt:
        """Bring what is held to its goal, in load steps if need be, and minimise."""
        run, loose = self._run, Limits(self._policy.minimise.load_step_tolerance)
        left = run.record.left(self._policy.minimise.max_iterations)

        def end_step(force: float, first: float) -> float:
            return loose.threshold(run.scene, max(first, force))

        state, force, reason, iterations = self._newton.approach(
            self._evaluate(run.u), self._goal, self._nodes, self._evaluate, threshold=end_step, max_iterations=left
        )
        if reason is None:
            newton = self._newton
            if self._rigid is not None:
                newton, state = self._freed, self._rigid.at(state.u, self._poses)
            state, reason, more = newton.minimise(
                state, threshold=lambda first: run.threshold(max(first, force)), max_iterations=left - iterations
            )
            iterations += more
        if reason is Reason.CONVERGED and self._may_be_unstable():
            state, more = self._leave_saddle(state, run.threshold, left - iterations)
            iterations += more
        run.record.add(iterations, **vars(self._work))
        return Attempt(reason, run.numbering, state.u, None, state.energy)

    def _may_be_unstable(self) -> bool:
        """Whether an equilibrium may be a saddle, of elastic tissue alone that is pulled, and factors are cheap."""
        scene = self._run.scene
        return (
            self._rigid is None
            and self._can_factor
            and bool(scene.of(Traction))
            and not any(term.may_soften for term in scene.terms)
        )

    def _leave_saddle(self, state: AnyState, threshold: Callable[[float], float], left: int) -> tuple[AnyState, int]:
        """Minimise anew from beside an unstable equilibrium, along its softest motion; give the iterations made."""
        drift = self._policy.minimise.drift if has_free_motion(self._run.scene) else 0.0
        comm, owned, X = self._problem.comm, self._nodes.owned, self._run.numbering.X
        mode = self._newton.find_soft_motion(state, irregular_vector(comm, X[:owned]), drift)
        if mode is None:
            return state, 0
        step = self._policy.minimise.aside * largest_size(comm, (state.u - self._run.u)[:owned])
        beside = self._evaluate(state.u + self._nodes.spread(step * mode.reshape(-1, 3)))
        if not np.isfinite(beside.energy):
            return state, 0
        end, reason, made = self._newton.minimise(beside, threshold=threshold, max_iterations=left)
        return (end if reason is Reason.CONVERGED and end.energy < state.energy else state), made

    def _evaluate(self, u: Floats) -> Evaluation:
        self._work.energies += 1
        return self._problem.at(u)

    def _report(self, state: AnyState, norm: float) -> bool:
        return self._run.report(state.u, state.energy, norm)
