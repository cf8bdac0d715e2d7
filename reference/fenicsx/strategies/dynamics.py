"""A march through time on FEniCSx: mesh, forms and factors once, an incremental minimisation per step.

With d the displacement since a step's beginning the sum to minimise is E(u₀ + d) + d·A d / 2 - d·r. A is constant as
long as the time step is; r is what mass, damper and the forces of the last step ask for. Sums over d, not over u, keep
rounding small where A is large.

From step to step the tangent changes little, and solving with factors at hand costs a small part of assembling and
factoring. Where the gradient stops falling fast the tangent is made anew; where that does not help either, Newton's
method with its line search takes over.

Every rank makes the march, and has the whole trajectory. Of u₀ and r each rank has what it owns. Edge nodes of "P2"
begin in the middle of their ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...march import Energies, Motion, Trajectory
from ...scene import Scene
from ...solution import Reason
from ...terms import Target
from ..dolfinx_version import PETSc
from ..linear.problem import Problem, State
from ..linear.solvers import Mumps, hold
from ..mesh.numbering import Numbering, ranks_for
from ..mesh.parallel import anywhere, check_same, dot, norm
from ..policy import POLICY, FenicsxPolicy
from .masses import accelerations, mass_matrix, times
from .newton import Newton

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class MovingProblem:
    """A Problem with A (3n, 3n) added; `begin` sets u₀ [mm] and r [mN], vectors (owned, 3).

    `size` [mm] is the sum of the tets' sizes.
    """

    def __init__(self, problem: Problem, added: PETSc.Mat, size: float):
        self.problem, self.added, self.comm = problem, added, problem.comm
        # The energy that A gives to a displacement as large as those that problem's scale is made of.
        spread = float(added.getDiagonal().norm(PETSc.NormType.NORM_1)) / max(added.getSize()[0], 1)
        self._added_scale = spread * size

    def begin(self, u: Floats, r: Floats):
        """Where a step begins."""
        self.origin, self.r = u, r

    @property
    def energy_scale(self) -> float:
        """See Problem."""
        return self.problem.energy_scale + self._added_scale

    def at(self, u: Floats) -> MovingState:
        """The step at its end's displacement [mm], a field (n, 3)."""
        return MovingState(self, self.problem.at(u))

    def moved(self, state: MovingState, step: Floats) -> MovingState:
        """The step after a change of all dofs [mm], a vector (3 owned,)."""
        return self.at(state.u + self.problem.numbering.nodes.spread(step.reshape(-1, 3)))


class MovingState:
    """Energy, gradient and Hessian of a step; `static` is the scene's own part."""

    def __init__(self, owner: MovingProblem, static: State):
        self._owner, self.static, self.u = owner, static, static.u
        d = self.u[: len(owner.origin)] - owner.origin
        self._pull = times(owner.added, d)
        self.energy = static.energy + dot(owner.comm, d, 0.5 * self._pull - owner.r)

    def gradient(self) -> Floats:
        """The gradient [mN], a vector (owned, 3), held components included."""
        return self.static.gradient() + self._pull - self._owner.r

    def hessian(self, kept: float = 1.0) -> PETSc.Mat:
        """The Hessian [mN/mm], in the problem's matrix; negative eigenvalues of the scene's part are times `kept`."""
        matrix = self.static.hessian(kept)
        matrix.axpy(1.0, self._owner.added, structure=SAME)
        return matrix


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a step ended, why, after how many iterations, and how often it factored."""

    state: MovingState
    reason: Reason
    iterations: int
    factorisations: int


class Chord:
    """Newton's method with one factorisation for as long as it serves, over the steps of one moving problem.

    `held` are the dofs that keep their place within a step (sorted, flat).
    """

    def __init__(self, problem: MovingProblem, held: Ints, policy: FenicsxPolicy = POLICY):
        self._problem, self._held, self._policy = problem, held, policy.march
        self._limit = policy.march.max_iterations
        matrix = problem.problem.matrix
        self._matrix = matrix.duplicate(copy=False)
        self._factors = Mumps(self._matrix, policy=policy.linear)
        mumps = Mumps(matrix, policy=policy.linear)
        self._newton = Newton(problem, held, mumps, mumps, lambda *_: False, policy=policy.newton)
        self._has_factors = False

    def minimise(self, state: MovingState, threshold: float) -> Minimum:
        """Iterate from a state of finite energy until the gradient norm [mN] of what is free is at most threshold."""
        gradient, norm = self._gradient(state)
        factored, fresh = 0, False
        for iteration in range(self._limit):
            if norm <= threshold:
                return Minimum(state, Reason.CONVERGED, iteration, factored)
            if not self._has_factors:
                hessian = state.hessian()
                hold(hessian, self._held, np.zeros(len(self._held)), np.zeros(hessian.getLocalSize()[0]))
                hessian.copy(self._matrix, structure=SAME)
                self._has_factors, factored, fresh = True, factored + 1, True
            after, gradient_after, norm_after = self._step(state, gradient)
            fell = norm_after <= self._policy.fast * norm
            if not fell:
                self._has_factors = False
                if fresh and not norm_after < norm:
                    return self._solve_by_newton(state, threshold, iteration, factored)
            if after is not None and norm_after < norm:
                state, gradient, norm, fresh = after, gradient_after, norm_after, False
        return Minimum(state, Reason.CONVERGED if norm <= threshold else Reason.MAX_ITERATIONS, self._limit, factored)

    def spread(self, state: MovingState, jump: Floats) -> Floats:
        """How a jump of the held dofs [mm], a vector (owned, 3), spreads to the others."""
        return self._newton.extension(state, jump)[0]

    def _gradient(self, state: MovingState) -> tuple[Floats, float]:
        gradient = self._newton.free_gradient(state)
        return gradient, self._newton.norm(gradient)

    def _step(self, state: MovingState, gradient: Floats) -> tuple[MovingState | None, Floats, float]:
        """The state after a full step, its gradient and its norm: infinite where the step is none to take."""
        answer = self._factors.solve(-gradient, relative=0.0)
        if answer.converged:
            answer.x[self._held] = 0.0
            after = self._problem.moved(state, answer.x)
            most = state.energy + self._policy.rounding * (self._problem.energy_scale + abs(state.energy))
            if after.energy <= most:
                return after, *self._gradient(after)
        return None, gradient, np.inf

    def _solve_by_newton(self, state: MovingState, threshold: float, made: int, factored: int) -> Minimum:
        before = self._newton.work.linear_solves
        end, reason, iterations = self._newton.minimise(
            state,
            threshold=lambda _: threshold,
            max_iterations=self._limit - made,
            near=True,  # a thirtieth of its first gradient norm, which is small, may be less than what is asked
        )
        self._has_factors = False
        assert isinstance(end, MovingState)
        return Minimum(end, reason, made + iterations, factored + self._newton.work.linear_solves - before)


@dataclass(frozen=True, eq=False)
class Moment:
    """All that a step starts from: u, a field, and forces, v, a and gradient, vectors (see `shared`).

    frame_forces [mN] are those of the accelerated frame; u [mm], v [mm/s], a [mm/s²]; gradient [mN] is that of the
    scene's energy with those forces, potential [µJ] that energy without them.
    """

    scene: Scene
    frame_forces: Floats
    u: Floats
    v: Floats
    a: Floats
    gradient: Floats
    potential: float


class March:
    """One march.

    `problem`, one of the motion's scene, lends mesh, forms and matrix; what they are set to is changed.
    """

    def __init__(self, motion: Motion, problem: Problem, policy: FenicsxPolicy = POLICY):
        self.motion, self.rule, self.h = motion, motion.scheme, motion.time_step
        self.comm = ranks_for(motion.scene)
        check_same(self.comm, motion.scene)
        scene = self._scene_at(0)
        if motion.skin_density.any() and self.comm.size > 1:  # of which other ranks may have to know
            problem = Problem(scene, Numbering(scene, problem.numbering.degree, comm=self.comm, skin=motion.skin))
        else:
            problem.set(scene)
        self.problem, self.numbering = problem, problem.numbering
        self.set_scene, self.dead_loads = scene, self.problem.loads
        self.mass = mass_matrix(motion, self.numbering, self.problem.stiffness)
        owned = self.numbering.nodes.owned
        self.frame_mass = times(self.mass, np.ones((owned, 3)))[:, 0]
        self.damper = self._damper()
        self.fixed = self.numbering.held(scene.dirichlet()[0])[:owned]
        massless = (self.mass.getDiagonal().array_r == 0.0).reshape(owned, 3)
        self.held = self.fixed | (self.problem.unsupported[:owned, None] & massless)
        beta, gamma = self.rule.by_acceleration[1], self.rule.to_velocity[1]
        added = self.mass.copy()
        added.scale((1.0 - self.rule.alpha_m) / ((1.0 - self.rule.alpha_f) * beta * self.h**2))
        if self.damper is not None:
            added.axpy(gamma / (beta * self.h), self.damper, structure=SAME)
        self.moving = MovingProblem(self.problem, added, float(np.cbrt(scene.volumes).sum()))
        self.chord = Chord(self.moving, np.flatnonzero(self.held), policy)
        total = self.numbering.nodes.total
        stiffness = float(added.getDiagonal().norm(PETSc.NormType.NORM_1)) / (3 * total)
        self.floor = 1e-14 * (scene.force_scale() + stiffness) * total**0.5

    def _damper(self) -> PETSc.Mat | None:
        """The matrix a M + b K, K the tangent at rest."""
        by_mass, by_stiffness = self.motion.damping
        if not (by_mass or by_stiffness):
            return None
        damper = self.mass.copy()
        damper.scale(by_mass)
        if by_stiffness:
            tangent = self.problem.at(np.zeros_like(self.numbering.X)).hessian()
            damper.axpy(by_stiffness, tangent, structure=SAME)
        return damper

    def _scene_at(self, step: int) -> Scene:
        scene = self.motion.scene_at(step)
        self.motion.scene.check_prepared_for(scene)
        return scene

    def _set(self, scene: Scene, step: int) -> Floats:
        """Put the problem at a step's scene and forces of the frame; give the latter."""
        if scene is not self.set_scene:
            self.problem.set(scene)
            self.set_scene, self.dead_loads = scene, self.problem.loads
        forces = -self.frame_mass[:, None] * self.motion.acceleration_at(step)
        self.problem.loads = self.dead_loads + forces
        return forces

    def _damp(self, v: Floats) -> Floats:
        """The damper's forces [mN] at velocities, vectors (owned, 3)."""
        return np.zeros_like(v) if self.damper is None else times(self.damper, v)

    def start(self) -> Moment:
        """Make the first moment, its acceleration by the balance of forces; held vertices are where they are held."""
        motion, numbering = self.motion, self.numbering
        scene = self._scene_at(0)
        frame_forces = self._set(scene, 0)
        held, places = scene.dirichlet()
        u = numbering.to_dofs(np.where(held, places, motion.positions)) - numbering.X
        moves = motion.fixed is not None or motion.scenes is not None
        v = np.where(self.held & (not moves), 0.0, numbering.to_dofs(motion.velocities)[: numbering.nodes.owned])
        state = self.problem.at(u)
        if not np.isfinite(state.energy):
            raise SceneError("march: the energy is not finite at the start; some tet is flat or inverted")
        gradient = state.gradient()
        a = accelerations(self.mass, -gradient - self._damp(v), ~self.held)
        return Moment(scene, frame_forces, u, v, a, gradient, state.energy + self._work(frame_forces, u))

    def run(self) -> Trajectory:
        """Make all steps, or those before one that fails."""
        record = _Record(self)
        now = self.start()
        record.add(now)
        before, scale, reason = now, 0.0, Reason.CONVERGED
        for step in range(1, self.motion.steps + 1):
            scene = self._scene_at(step)
            changed = scene if scene is not now.scene else None
            frame_forces = self._set(scene, step)
            r, v_still, a_still = self._step_forces(now)
            self.moving.begin(self._own(now.u), r)
            scale = max(scale, self._free_norm(now.gradient - r))
            state = self._begin(now, before, scene)
            if state is None:
                reason = Reason.NOT_FINITE
                break
            scale = max(scale, self._free_norm(state.gradient())) if step == 1 or changed else scale
            rounding = max(self.floor, 1e-15 * norm(self.comm, r))
            minimum = self.chord.minimise(state, max(self.motion.tolerance * scale, rounding))
            if minimum.reason is not Reason.CONVERGED:
                reason = minimum.reason
                break
            before, now = now, self._end(now, minimum.state, scene, frame_forces, v_still, a_still)
            if record.add(now, minimum.iterations, minimum.factorisations):
                reason = Reason.INTERRUPTED
                break
        return record.trajectory(reason)

    def _step_forces(self, now: Moment) -> tuple[Floats, Floats, Floats]:
        """Forces r of the step, and the end's velocity and acceleration if nothing moved."""
        rule, h = self.rule, self.h
        a = -(now.v / h + rule.by_acceleration[0] * now.a) / rule.by_acceleration[1]
        v = now.v + h * (rule.to_velocity[0] * now.a + rule.to_velocity[1] * a)
        kept = 1.0 - rule.alpha_f
        pulls = times(self.mass, (1.0 - rule.alpha_m) * a + rule.alpha_m * now.a) / kept
        pulls += self._damp(v + rule.alpha_f / kept * now.v)
        pulls += rule.alpha_f / kept * now.gradient
        return -pulls, v, a

    def _begin(self, now: Moment, before: Moment, scene: Scene) -> MovingState | None:
        """The best of some starts: going on, only held nodes moving, and held nodes that take the others along."""
        places = self.numbering.to_dofs(scene.dirichlet()[1]) - self.numbering.X
        fixed = self.numbering.held(scene.dirichlet()[0])
        on = 2.0 * now.u - before.u if before is not now else now.u + self.h * self.numbering.nodes.spread(now.v)
        starts = [self.moving.at(np.where(fixed, places, u)) for u in (on, now.u)]
        starts = [state for state in starts if np.isfinite(state.energy)]
        if starts:
            return min(starts, key=lambda state: state.energy)
        jump = np.where(fixed, places - now.u, 0.0)[: self.numbering.nodes.owned]
        spread = self.numbering.nodes.spread(self.chord.spread(self.moving.at(now.u), jump))
        state = self.moving.at(now.u + spread)
        return state if np.isfinite(state.energy) else None

    def _end(self, now: Moment, state: MovingState, scene, frame_forces, v_still, a_still) -> Moment:
        d = self._own(state.u - now.u)
        beta, gamma = self.rule.by_acceleration[1], self.rule.to_velocity[1]
        a = a_still + d / (beta * self.h**2)
        v = v_still + gamma * d / (beta * self.h)
        potential = state.static.energy + self._work(frame_forces, state.u)
        return Moment(scene, frame_forces, state.u, v, a, state.static.gradient(), potential)

    def _free_norm(self, forces: Floats) -> float:
        return norm(self.comm, forces[~self.held])

    def _own(self, u: Floats) -> Floats:
        """The vector of a field."""
        return u[: self.numbering.nodes.owned]

    def _work(self, forces: Floats, u: Floats) -> float:
        """The work [µJ] of forces, a vector, on a field of displacements."""
        return dot(self.comm, forces, self._own(u))

    def kinetic(self, now: Moment) -> float:
        """v·M v / 2 [µJ]."""
        return 0.5 * dot(self.comm, now.v, times(self.mass, now.v))

    def dissipated(self, before: Moment, now: Moment) -> float:
        """The damper's work in a step [µJ], by the mean velocity."""
        v = 0.5 * (before.v + now.v)
        return self.h * dot(self.comm, v, self._damp(v))

    def put_in(self, before: Moment, now: Moment) -> float:
        """The work of the frame, held nodes and targets in a step [µJ], by the mean of their forces."""
        moved = self._own(now.u - before.u)
        work = 0.5 * float(((before.frame_forces + now.frame_forces) * moved).sum())
        reactions = 0.5 * (self._reactions(before) + self._reactions(now))
        work += float((reactions * moved)[self.held].sum())
        for old, new in zip(before.scene.of(Target), now.scene.of(Target), strict=True):
            if new is not old:
                mine, dofs = self.numbering.own_dofs(new.name, new.vertices)
                places = 0.5 * (old.positions + new.positions)[mine]
                away = self.numbering.X[dofs] + 0.5 * (before.u + now.u)[dofs] - places
                stiffness = np.broadcast_to(new.stiffness, len(new.vertices))[mine]
                work -= float((stiffness[:, None] * away * (new.positions - old.positions)[mine]).sum())
        return self.comm.allreduce(work)

    def _reactions(self, now: Moment) -> Floats:
        return times(self.mass, now.a) + self._damp(now.v) + now.gradient


class _Record:
    """What is kept of each moment."""

    def __init__(self, owner: March):
        self._owner = owner
        self._last: Moment | None = None
        self._rows: list[tuple[float, float, float, float]] = []
        self._places: list[Floats] = []
        self._speeds: list[Floats] = []
        self._counts: list[tuple[int, int]] = []

    def add(self, now: Moment, iterations: int = 0, factorisations: int = 0) -> bool:
        """Add a moment; give whether the callback asks to stop."""
        owner, motion = self._owner, self._owner.motion
        first = self._last is None
        dissipated, put_in = (0.0, 0.0) if first else self._rows[-1][2:]
        if self._last is not None:
            dissipated += owner.dissipated(self._last, now)
            put_in += owner.put_in(self._last, now)
            self._counts.append((iterations, factorisations))
        self._rows.append((owner.kinetic(now), now.potential, dissipated, put_in))
        self._last = now
        held, places = now.scene.dirichlet()
        x = owner.numbering.to_scene(owner.numbering.X + now.u, places)
        x[held] = places[held]
        v = owner.numbering.to_scene(now.v, np.zeros_like(x))
        self._places.append(x[motion.vertices])
        self._speeds.append(v[motion.vertices])
        step = len(self._counts)
        stop = not first and motion.on_step is not None and bool(motion.on_step(step, step * owner.h, x))
        return anywhere(owner.comm, stop)

    def trajectory(self, reason: Reason) -> Trajectory:
        rows = np.array(self._rows)
        counts: Ints = np.array(self._counts, dtype=np.int64).reshape(-1, 2)
        return Trajectory(
            self._owner.h,
            self._owner.h * np.arange(len(rows)),
            np.array(self._places),
            np.array(self._speeds),
            self._owner.motion.vertices,
            Energies(*rows.T),
            counts[:, 0],
            counts[:, 1],
            reason,
        )
