"""A march through time on FEniCSx: mesh, forms and factors once, an incremental minimisation per step.

Of several processes every one makes the march, and has the whole trajectory. Edge nodes of "P2" begin in the middle of
their ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints
from ..march import Energies, Motion, Trajectory
from ..scene import Scene, refuse_unknown
from ..solution import Reason
from ..terms import Target
from .dolfinx_version import PETSc
from .masses import accelerations, mass_matrix, times
from .moving import Chord, MovingProblem, MovingState
from .numbering import Numbering
from .problem import Problem
from .scope import LAWS, MOVING_TERMS, processes_for
from .shared import anywhere, check_same, dot, norm

ELEMENTS = ("P1", "P2")
MAX_ITERATIONS = 100


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


def check(motion: Motion, element: str):
    """Raise SceneError for what a march cannot model."""
    if element not in ELEMENTS:
        raise SceneError(f"march: unknown element {element!r}; there are {', '.join(ELEMENTS)}")
    refuse_unknown(motion.scene, "fenicsx, march", MOVING_TERMS, LAWS)
    if motion.scene.in_parts:
        raise SceneError("march: processes have this scene in parts; solver 'fenicsx' marches whole ones")


def bare(motion: Motion) -> Motion:
    """A motion without what only the process that runs a command has: courses and callback."""
    return replace(motion, targets=None, fixed=None, scenes=None, acceleration=None, on_step=None)


class March:
    """One march. Scenes and frames are what the first process has for a step.

    `problem`, one of the motion's scene, lends mesh, forms and matrix; what they are set to is changed.
    """

    def __init__(self, motion: Motion, problem: Problem):
        self.motion, self.rule, self.h = motion, motion.scheme, motion.time_step
        self.comm = processes_for(motion.scene)
        check_same(self.comm, motion.scene)
        self._scene = motion.scene
        scene = self._scene_at(0)
        if motion.skin_density.any() and self.comm.size > 1:  # of which other processes may have to know
            problem = Problem(scene, Numbering(scene, problem.numbering.degree, comm=self.comm, skin=motion.skin))
        else:
            problem.set(scene)
        self.problem, self.order = problem, problem.numbering
        self.set_scene, self.dead_loads = scene, self.problem.loads
        self.mass = mass_matrix(motion, self.order, self.problem.stiffness)
        owned = self.order.nodes.owned
        self.frame_mass = times(self.mass, np.ones((owned, 3)))[:, 0]
        self.damper = self._damper()
        self.fixed = self.order.held(scene.dirichlet()[0])[:owned]
        massless = (self.mass.getDiagonal().array_r == 0.0).reshape(owned, 3)
        self.held = self.fixed | (self.problem.unsupported[:owned, None] & massless)
        beta, gamma = self.rule.by_acceleration[1], self.rule.to_velocity[1]
        added = self.mass.copy()
        added.scale((1.0 - self.rule.alpha_m) / ((1.0 - self.rule.alpha_f) * beta * self.h**2))
        if self.damper is not None:
            added.axpy(gamma / (beta * self.h), self.damper, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.moving = MovingProblem(self.problem, added, float(np.cbrt(scene.volumes).sum()))
        self.chord = Chord(self.moving, np.flatnonzero(self.held), MAX_ITERATIONS)
        total = self.order.nodes.total
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
            tangent = self.problem.at(np.zeros_like(self.order.X)).hessian()
            damper.axpy(by_stiffness, tangent, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return damper

    def _scene_at(self, step: int) -> Scene:
        scene = self.motion.scene_at(step) if self.comm.rank == 0 else None
        if self.comm.bcast(scene is not self._scene):
            self._scene = self.comm.bcast(scene)
            self.motion.scene.check_prepared_for(self._scene)
        return self._scene

    def _set(self, scene: Scene, step: int) -> Floats:
        """Put the problem at a step's scene and forces of the frame; give the latter."""
        if scene is not self.set_scene:
            self.problem.set(scene)
            self.set_scene, self.dead_loads = scene, self.problem.loads
        acceleration = self.comm.bcast(self.motion.acceleration_at(step))
        forces = -self.frame_mass[:, None] * acceleration
        self.problem.loads = self.dead_loads + forces
        return forces

    def _damped(self, v: Floats) -> Floats:
        return np.zeros_like(v) if self.damper is None else times(self.damper, v)

    def start(self) -> Moment:
        """The first moment, its acceleration by the balance of forces; held vertices are where they are held."""
        motion, order = self.motion, self.order
        scene = self._scene_at(0)
        frame_forces = self._set(scene, 0)
        held, places = scene.dirichlet()
        u = order.to_dofs(np.where(held, places, motion.positions)) - order.X
        moves = self.comm.bcast(motion.fixed is not None or motion.scenes is not None)
        v = np.where(self.held & (not moves), 0.0, order.to_dofs(motion.velocities)[: order.nodes.owned])
        state = self.problem.at(u)
        if not np.isfinite(state.energy):
            raise SceneError("march: the energy is not finite at the start; some tet is flat or inverted")
        gradient = state.gradient()
        a = accelerations(self.mass, -gradient - self._damped(v), ~self.held)
        return Moment(scene, frame_forces, u, v, a, gradient, state.energy + self._work(frame_forces, u))

    def run(self) -> Trajectory:
        """All steps, or those before one that fails."""
        record = _Record(self)
        now = self.start()
        record.add(now)
        before, scale, reason = now, 0.0, Reason.CONVERGED
        for step in range(1, self.motion.steps + 1):
            scene = self._scene_at(step)
            changed = scene if scene is not now.scene else None
            frame_forces = self._set(scene, step)
            r, v_still, a_still = self._asked(now)
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

    def _asked(self, now: Moment) -> tuple[Floats, Floats, Floats]:
        """Forces r of the step, and the end's velocity and acceleration if nothing moved."""
        rule, h = self.rule, self.h
        a = -(now.v / h + rule.by_acceleration[0] * now.a) / rule.by_acceleration[1]
        v = now.v + h * (rule.to_velocity[0] * now.a + rule.to_velocity[1] * a)
        kept = 1.0 - rule.alpha_f
        pulls = times(self.mass, (1.0 - rule.alpha_m) * a + rule.alpha_m * now.a) / kept
        pulls += self._damped(v + rule.alpha_f / kept * now.v)
        pulls += rule.alpha_f / kept * now.gradient
        return -pulls, v, a

    def _begin(self, now: Moment, before: Moment, scene: Scene) -> MovingState | None:
        """The best of some starts: going on, only held nodes moving, and held nodes that take the others along."""
        places = self.order.to_dofs(scene.dirichlet()[1]) - self.order.X
        fixed = self.order.held(scene.dirichlet()[0])
        on = 2.0 * now.u - before.u if before is not now else now.u + self.h * self.order.nodes.spread(now.v)
        starts = [self.moving.at(np.where(fixed, places, u)) for u in (on, now.u)]
        starts = [state for state in starts if np.isfinite(state.energy)]
        if starts:
            return min(starts, key=lambda state: state.energy)
        jump = np.where(fixed, places - now.u, 0.0)[: self.order.nodes.owned]
        spread = self.order.nodes.spread(self.chord.spread(self.moving.at(now.u), jump))
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
        return u[: self.order.nodes.owned]

    def _work(self, forces: Floats, u: Floats) -> float:
        """The work [µJ] of forces, a vector, on a field of displacements."""
        return dot(self.comm, forces, self._own(u))

    def kinetic(self, now: Moment) -> float:
        """v·M v / 2 [µJ]."""
        return 0.5 * dot(self.comm, now.v, times(self.mass, now.v))

    def dissipated(self, before: Moment, now: Moment) -> float:
        """The damper's work in a step [µJ], by the mean velocity."""
        v = 0.5 * (before.v + now.v)
        return self.h * dot(self.comm, v, self._damped(v))

    def put_in(self, before: Moment, now: Moment) -> float:
        """The work of the frame, held nodes and targets in a step [µJ], by the mean of their forces."""
        moved = self._own(now.u - before.u)
        work = 0.5 * float(((before.frame_forces + now.frame_forces) * moved).sum())
        reactions = 0.5 * (self._reactions(before) + self._reactions(now))
        work += float((reactions * moved)[self.held].sum())
        for old, new in zip(before.scene.of(Target), now.scene.of(Target), strict=True):
            if new is not old:
                mine, dofs = self.order.own_dofs(new.name, new.vertices)
                places = 0.5 * (old.positions + new.positions)[mine]
                away = self.order.X[dofs] + 0.5 * (before.u + now.u)[dofs] - places
                stiffness = np.broadcast_to(new.stiffness, len(new.vertices))[mine]
                work -= float((stiffness[:, None] * away * (new.positions - old.positions)[mine]).sum())
        return self.comm.allreduce(work)

    def _reactions(self, now: Moment) -> Floats:
        return times(self.mass, now.a) + self._damped(now.v) + now.gradient


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
        x = owner.order.to_scene(owner.order.X + now.u, places)
        x[held] = places[held]
        v = owner.order.to_scene(now.v, np.zeros_like(x))
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
