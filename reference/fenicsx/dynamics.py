"""A march through time on FEniCSx: mesh, forms and factors once, an incremental minimisation per step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.errors import SceneError
from ...lhm.mesh import Floats, Ints
from ..march import Motion
from ..scene import Scene, refuse_unknown
from ..solution import Reason
from ..terms import Inertia, Pressure, RigidBody, Target
from ..trajectory import Energies, Trajectory
from .chord import Chord
from .dolfinx_version import PETSc
from .masses import accelerations, as_blocks, mass_matrix, times
from .moving import MovingProblem, MovingState
from .numbering import Numbering
from .prepared import LAWS, VARYING
from .prepared import TERMS as STATIC_TERMS
from .shares import problem_of

TERMS = tuple(kind for kind in STATIC_TERMS if kind not in (RigidBody, Pressure, Inertia))
ELEMENTS = {"P1": 1, "P2": 2}
MAX_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class Moment:
    """All that a step starts from: forces, u, v, a and gradient by node, shape (n, 3).

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


def march(motion: Motion, *, element: str = "P1") -> Trajectory:
    """See `softdeca.reference.march`. Edge nodes of "P2" begin in the middle of their ends."""
    if element not in ELEMENTS:
        raise SceneError(f"march: unknown element {element!r}; there are {', '.join(ELEMENTS)}")
    refuse_unknown(motion.scene, "fenicsx, march", TERMS, LAWS)
    return _March(motion, ELEMENTS[element]).run()


class _March:
    def __init__(self, motion: Motion, degree: int):
        self.motion, self.rule, self.h = motion, motion.scheme, motion.time_step
        scene = self._scene_at(0)
        self.order = Numbering(scene, degree)
        self.problem = problem_of(scene, self.order)
        self.set_scene, self.dead_loads = scene, self.problem.loads
        self.mass = mass_matrix(motion, self.order)
        self.frame_mass = np.asarray(self.mass.sum(axis=1)).ravel()
        matrix = self.problem.matrix
        self.mass_blocks = as_blocks(self.mass, matrix)
        self.damper = self._damper()
        held = self.order.held(scene.dirichlet()[0])
        massless = self.mass.diagonal() == 0.0
        self.held = held | (self.problem.unsupported & massless)[:, None]
        beta, gamma = self.rule.by_acceleration[1], self.rule.to_velocity[1]
        added = self.mass_blocks.copy()
        added.scale((1.0 - self.rule.alpha_m) / ((1.0 - self.rule.alpha_f) * beta * self.h**2))
        if self.damper is not None:
            added.axpy(gamma / (beta * self.h), self.damper, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.moving = MovingProblem(self.problem, added)
        self.chord = Chord(self.moving, np.flatnonzero(self.held), MAX_ITERATIONS)
        self.floor = 1e-14 * (scene.force_scale() + np.abs(added.getDiagonal().array).mean()) * len(self.order.X) ** 0.5

    def _damper(self) -> PETSc.Mat | None:
        """The matrix a M + b K, K the tangent at rest."""
        by_mass, by_stiffness = self.motion.damping
        if not (by_mass or by_stiffness):
            return None
        damper = self.mass_blocks.copy()
        damper.scale(by_mass)
        if by_stiffness:
            tangent = self.problem.at(np.zeros_like(self.order.X)).hessian()
            damper.axpy(by_stiffness, tangent, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return damper

    def _scene_at(self, step: int) -> Scene:
        scene = self.motion.scene_at(step)
        self.motion.scene.check_prepared_for(scene, varying=VARYING)
        return scene

    def _set(self, scene: Scene, step: int) -> Floats:
        """Put the problem at a step's scene and forces of the frame; give the latter."""
        if scene is not self.set_scene:
            self.problem.set(scene)
            self.set_scene, self.dead_loads = scene, self.problem.loads
        forces = -self.frame_mass[:, None] * self.motion.acceleration_at(step)
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
        moves = motion.fixed is not None or motion.scenes is not None
        v = np.where(self.held & (not moves), 0.0, order.to_dofs(motion.velocities))
        state = self.problem.at(u)
        if not np.isfinite(state.energy):
            raise SceneError("march: the energy is not finite at the start; some tet is flat or inverted")
        gradient = state.gradient()
        a = accelerations(self.mass, -gradient - self._damped(v), ~self.held)
        return Moment(scene, frame_forces, u, v, a, gradient, state.energy + float((frame_forces * u).sum()))

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
            self.moving.begin(now.u, r)
            scale = max(scale, self._free_norm(now.gradient - r))
            state = self._begin(now, before, scene)
            if state is None:
                reason = Reason.NOT_FINITE
                break
            scale = max(scale, self._free_norm(state.gradient())) if step == 1 or changed else scale
            rounding = max(self.floor, 1e-15 * float(np.linalg.norm(r)))
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
        pulls = times(self.mass_blocks, (1.0 - rule.alpha_m) * a + rule.alpha_m * now.a) / kept
        pulls += self._damped(v + rule.alpha_f / kept * now.v)
        pulls += rule.alpha_f / kept * now.gradient
        return -pulls, v, a

    def _begin(self, now: Moment, before: Moment, scene: Scene) -> MovingState | None:
        """The best of some starts: going on, only held nodes moving, and held nodes that take the others along."""
        places = self.order.to_dofs(scene.dirichlet()[1]) - self.order.X
        fixed = self.order.held(scene.dirichlet()[0])
        on = 2.0 * now.u - before.u if before is not now else now.u + self.h * now.v
        starts = [self.moving.at(np.where(fixed, places, u)) for u in (on, now.u)]
        starts = [state for state in starts if np.isfinite(state.energy)]
        if starts:
            return min(starts, key=lambda state: state.energy)
        jump = np.where(fixed, places - now.u, 0.0)
        state = self.moving.at(now.u + self.chord.spread(self.moving.at(now.u), jump))
        return state if np.isfinite(state.energy) else None

    def _end(self, now: Moment, state: MovingState, scene, frame_forces, v_still, a_still) -> Moment:
        d = state.u - now.u
        beta, gamma = self.rule.by_acceleration[1], self.rule.to_velocity[1]
        a = a_still + d / (beta * self.h**2)
        v = v_still + gamma * d / (beta * self.h)
        potential = state.static.energy + float((frame_forces * state.u).sum())
        return Moment(scene, frame_forces, state.u, v, a, state.static.gradient(), potential)

    def _free_norm(self, forces: Floats) -> float:
        return float(np.linalg.norm(forces[~self.held]))

    def kinetic(self, now: Moment) -> float:
        """v·M v / 2 [µJ]."""
        return 0.5 * float((now.v * (self.mass @ now.v)).sum())

    def dissipated(self, before: Moment, now: Moment) -> float:
        """The damper's work in a step [µJ], by the mean velocity."""
        v = 0.5 * (before.v + now.v)
        return self.h * float((v * self._damped(v)).sum())

    def put_in(self, before: Moment, now: Moment) -> float:
        """The work of the frame, held nodes and targets in a step [µJ], by the mean of their forces."""
        moved = now.u - before.u
        work = 0.5 * float(((before.frame_forces + now.frame_forces) * moved).sum())
        reactions = 0.5 * (self._reactions(before) + self._reactions(now))
        work += float((reactions * moved)[self.held].sum())
        for old, new in zip(before.scene.of(Target), now.scene.of(Target), strict=True):
            if new is not old:
                dofs = self.order.dof[new.vertices]
                away = self.order.X[dofs] + 0.5 * (before.u + now.u)[dofs] - 0.5 * (old.positions + new.positions)
                stiffness = np.broadcast_to(new.stiffness, len(dofs))
                work -= float((stiffness[:, None] * away * (new.positions - old.positions)).sum())
        return work

    def _reactions(self, now: Moment) -> Floats:
        return times(self.mass_blocks, now.a) + self._damped(now.v) + now.gradient


class _Record:
    """What is kept of each moment."""

    def __init__(self, owner: _March):
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
        return not first and motion.on_step is not None and bool(motion.on_step(step, step * owner.h, x))

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
