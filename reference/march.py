"""Time marching: a scene through time by an implicit scheme, on any solver.

A step's acceleration is linear in where it ends, a₁ = (x₁ - still) / (β₁ h²), and mass is lumped at vertices. So the
balance of forces at its end is that of the scene with one spring more at each vertex that has mass: a step is a static
solve, prepared once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from ..lhm.base.checks import check_arguments
from ..lhm.base.errors import InputError, SceneError
from ..lhm.base.limits import MARCH_STEPS, MARCH_VALUES
from ..lhm.base.mesh import Floats, Ints
from .added import all_solvers
from .scene import Scene
from .solution import Reason, Solution
from .solve import prepare, solve
from .terms import Fixed, Inertia, RigidBody, Target

DEFAULTS = {"fenicsx": {"linear_solver": "chord"}}
"""Options of solvers that suit steps which differ little."""
SCHEMES = ("implicit Euler", "Newmark", "generalised-alpha")

LONGEST = 1e6
"""A time step [s]: eleven days."""
Course: TypeAlias = Callable[[float], Floats] | Floats
"""A function of time [s], or its values at the steps' ends, first axis (steps,)."""


@dataclass(frozen=True)
class Scheme:
    """How displacement, velocity and acceleration at two times hang together, and where forces balance.

    u₁ = u₀ + h v₀ + h² (β₀ a₀ + β₁ a₁) and v₁ = v₀ + h (γ₀ a₀ + γ₁ a₁), with
    M (α_m a₀ + (1 - α_m) a₁) + α_f (c M v₀ + f₀) + (1 - α_f) (c M v₁ + f₁) = 0. `name` is for reports.
    """

    name: str
    by_acceleration: tuple[float, float]  # β₀, β₁
    to_velocity: tuple[float, float]  # γ₀, γ₁
    alpha_m: float = 0.0
    alpha_f: float = 0.0

    @classmethod
    def from_name(cls, name: str, *, spectral_radius: float = 0.8) -> Scheme:
        """Make a scheme by name; spectral_radius in [0, 1] is that of "generalised-alpha" at infinite frequency.

        "implicit Euler" is of order 1 and damps what it does not resolve; "Newmark" (β = 1/4, γ = 1/2) and
        "generalised-alpha" (Chung and Hulbert 1993) are of order 2, the former without loss at any frequency, the
        latter with loss at high ones only. Raises SceneError for another name or radius.
        """
        if name not in SCHEMES:
            raise SceneError(f"unknown scheme {name!r}; there are {', '.join(SCHEMES)}")
        radius = float(spectral_radius)
        if not 0.0 <= radius <= 1.0:
            raise SceneError(f"spectral_radius: must lie in [0, 1], got {spectral_radius!r}")
        if name == "implicit Euler":
            return cls(name, (0.0, 1.0), (0.0, 1.0))
        alpha_m = alpha_f = 0.0
        if name == "generalised-alpha":
            alpha_m, alpha_f = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        gamma = 0.5 - alpha_m + alpha_f
        beta = 0.25 * float(np.square(1.0 - alpha_m + alpha_f))
        return cls(name, (0.5 - beta, beta), (1.0 - gamma, gamma), alpha_m, alpha_f)


@dataclass(frozen=True, eq=False)
class Energies:
    """Energies at each time [µJ], shape (k + 1,); the first two are states, the others sums since the start.

    `dissipated` is the work of viscous damping, `input` that of moving targets, held vertices and an accelerated frame;
    that of loads and sought volumes which change with time is not counted.
    kinetic + potential + dissipated - input stays as it is but for what the scheme loses (or gains).
    """

    kinetic: Floats
    potential: Floats
    dissipated: Floats
    input: Floats

    @property
    def balance(self) -> Floats:
        """What the scheme adds: kinetic + potential + dissipated - input, less its first value [µJ], shape (k + 1,)."""
        total = self.kinetic + self.potential + self.dissipated - self.input
        return total - total[0]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The steps made, and why the march ended: CONVERGED if all were made, else what ended the last one.

    time_step [s]; times [s], shape (k + 1,), from the start; positions [mm] and velocities [mm/s] of the kept
    vertices, shape (k + 1, kept, 3); `vertices` (kept,) are their numbers; iterations (k,) per step. A step that failed
    is not among them.
    """

    time_step: float
    times: Floats
    positions: Floats
    velocities: Floats
    vertices: Ints
    energies: Energies
    iterations: Ints
    reason: Reason

    @property
    def converged(self) -> bool:
        """Whether every step reached its tolerance."""
        return self.reason is Reason.CONVERGED


OnStep = Callable[[int, float, Floats], "bool | None"]
"""Called with step, time [s] and positions [mm], shape (scene's vertices, 3); returning True ends the march."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A march as solvers take it, checked: see `march` for what the fields are."""

    scene: Scene
    scheme: Scheme
    time_step: float
    steps: int
    density: Floats
    skin: Ints
    skin_density: Floats
    damping: float
    targets: Course | None
    fixed: Course | None
    scenes: Callable[[float], Scene] | None
    acceleration: Course | None
    positions: Floats
    velocities: Floats
    vertices: Ints
    tolerance: float
    on_step: OnStep | None = field(default=None, repr=False)

    def scene_at(self, step: int) -> Scene:
        """Return the scene at the end of a step, from 1, or at the start, 0: the given one if values are per step."""
        scene = self.scene if self.scenes is None else self.scenes(step * self.time_step)
        if (targets := self._evaluate(self.targets, step)) is not None:
            scene = scene.with_targets(targets)
        if (fixed := self._evaluate(self.fixed, step)) is not None:
            scene = scene.with_fixed(fixed)
        return scene

    def acceleration_at(self, step: int) -> Floats:
        """Return the frame's acceleration [mm/s²], shape (3,); values per step start with the first step's."""
        value = self._evaluate(self.acceleration, step if callable(self.acceleration) else max(step, 1))
        vector = np.zeros(3) if value is None else np.asarray(value, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise SceneError(f"acceleration: expected three finite numbers, got {value!r}")
        return vector

    def _evaluate(self, course: Course | None, step: int) -> Floats | None:
        if course is None:
            return None
        if callable(course):
            return course(step * self.time_step)
        return course[step - 1] if step else None


@check_arguments
def march(
    scene: Scene,
    *,
    time_step: float,
    steps: int,
    solver: str = "fenicsx",
    scheme: str | Scheme = "implicit Euler",
    spectral_radius: float = 0.8,
    density: float | Floats = 0.0,
    skin: Ints | None = None,
    skin_density: float | Floats = 0.0,
    damping: float = 0.0,
    targets: Course | None = None,
    fixed: Course | None = None,
    scenes: Callable[[float], Scene] | None = None,
    acceleration: Course | None = None,
    positions: Floats | None = None,
    velocities: Floats | None = None,
    keep: Ints | None = None,
    tolerance: float = 1e-8,
    on_step: OnStep | None = None,
    **options,
) -> Trajectory:
    """March a scene through `steps` of `time_step` [s]: M (a + c v) + f(x) = 0 by an implicit scheme.

    scheme is a name of SCHEMES or a Scheme. Mass is `density` [kg/mm³] of the tets, one or one per tet, and
    `skin_density` [kg/mm²] of triangles `skin` (k, 3), one or one per triangle, lumped at vertices; what has none
    follows in balance, from the start on. damping c [1/s] is by mass. `targets` and `fixed` [mm] move the one Target
    and the one Fixed term, `acceleration` [mm/s²] is that of the frame that positions are measured in (a shaken head):
    functions of time, or arrays of one value per step. Else `scenes` gives the scene by time: it may differ in targets,
    held positions, loads, limits and volumes sought. positions [mm] and velocities [mm/s] are those at the start, shape
    (n, 3), default rest; keep (kept,) vertices are recorded, default all. tolerance: of the forces that act if nothing
    moves on in a step, the largest so far. `options` are the solver's. Under mpirun, `on_step` answers every process
    alike.

    Raises SceneError for what is out of range, a scene with Inertia (mass is given here) or RigidBody, or no mass at
    all, and what the solver cannot model; MissingDependencyError if its packages are not installed.
    """
    if solver not in all_solvers():
        raise SceneError(f"march: unknown solver {solver!r}; there are {', '.join(all_solvers())}")
    rule = scheme if isinstance(scheme, Scheme) else Scheme.from_name(scheme, spectral_radius=spectral_radius)
    motion = _check(
        scene, time_step, steps, rule, density, skin, skin_density, damping,
        targets, fixed, scenes, acceleration, positions, velocities, keep, tolerance, on_step,
    )  # fmt: skip
    return _March(motion, solver, DEFAULTS.get(solver, {}) | options).run()


@dataclass(frozen=True, eq=False)
class _Moment:
    """All that a step starts from: x [mm], v [mm/s], a [mm/s²], each (n, 3), at the end of a solution.

    `gradient` [mN] is the scene's where there is mass, `springs` [mN] the forces of the step's springs, `frame`
    [mm/s²] the frame's acceleration, `potential` [µJ] the scene's energy.
    """

    scene: Scene
    solution: Solution
    frame: Floats
    x: Floats
    v: Floats
    a: Floats
    gradient: Floats
    springs: Floats
    potential: float


class _March:
    """One march: springs of every step have one stiffness, so that a solver prepares once."""

    def __init__(self, motion: Motion, solver: str, options: dict):
        self.motion, self.rule, self.h = motion, motion.scheme, motion.time_step
        self.solver, self.options = solver, options
        self.mass = _lump_masses(motion)[:, None]
        self.heavy = np.flatnonzero(self.mass)
        rule, h = self.rule, self.h
        by_mass = (1.0 - rule.alpha_m) / ((1.0 - rule.alpha_f) * rule.by_acceleration[1] * h**2)
        by_damping = motion.damping * rule.to_velocity[1] / (rule.by_acceleration[1] * h)
        self.stiffness = (by_mass + by_damping) * self.mass
        self.prepared = prepare(self._with_springs(motion.scene, motion.positions), solver=solver, **options)
        self.scale = 0.0

    def _with_springs(self, scene: Scene, places: Floats) -> Scene:
        springs = Target(self.heavy, places[self.heavy], self.stiffness[self.heavy, 0])
        return replace(scene, terms=(*scene.terms, springs))

    def start(self) -> _Moment:
        """Make the first moment: mass where it is told to be, the rest in balance, accelerations by what is not."""
        motion = self.motion
        scene, frame = motion.scene_at(0), motion.acceleration_at(0)
        held, places = scene.dirichlet()
        x = np.where(held, places, motion.positions)
        moves = motion.fixed is not None or motion.scenes is not None
        v = np.where(held & (not moves), 0.0, motion.velocities)
        pinned = replace(scene, terms=(*scene.terms, Fixed(self.heavy, x[self.heavy])))
        found = solve(pinned, solver=self.solver, start=x, tolerance=motion.tolerance, **self.options)
        if not found.converged:
            raise SceneError(f"march: the start has no balance of forces; {found.reason}")
        heavy = self.mass > 0.0
        gradient = np.where(heavy, found.reactions, 0.0)
        pulls = gradient / np.where(heavy, self.mass, 1.0) + frame + motion.damping * v
        a = np.where(heavy & ~held, -pulls, 0.0)
        return _Moment(scene, found, frame, found.positions, v, a, gradient, np.zeros_like(x), found.energy)

    def run(self) -> Trajectory:
        """Make all steps, or those before one that fails."""
        now, motion = self.start(), self.motion
        moments, rows, iterations = [now], [(self._kinetic(now), now.potential, 0.0, 0.0)], []
        reason = Reason.CONVERGED
        for step in range(1, motion.steps + 1):
            after = self._step(now, step)
            if isinstance(after, Reason):
                reason = after
                break
            dissipated, put_in = rows[-1][2] + self._dissipated(now, after), rows[-1][3] + self._put_in(now, after)
            rows.append((self._kinetic(after), after.potential, dissipated, put_in))
            iterations.append(after.solution.iterations)
            moments.append(after)
            now = after
            if motion.on_step is not None and motion.on_step(step, step * self.h, now.x):
                reason = Reason.INTERRUPTED
                break
        return Trajectory(
            self.h,
            self.h * np.arange(len(rows)),
            np.array([moment.x[motion.vertices] for moment in moments]),
            np.array([moment.v[motion.vertices] for moment in moments]),
            motion.vertices,
            Energies(*np.array(rows).T),
            np.array(iterations, dtype=np.int64),
            reason,
        )

    def _step(self, now: _Moment, number: int) -> _Moment | Reason:
        """Make a step, or say why it failed."""
        motion, rule, h, mass = self.motion, self.rule, self.h, self.mass
        scene, frame = motion.scene_at(number), motion.acceleration_at(number)
        still = now.x + h * now.v + h**2 * rule.by_acceleration[0] * now.a
        v_still = now.v + h * rule.to_velocity[0] * now.a
        before = now.gradient + mass * (now.frame + motion.damping * now.v)
        forces = mass * (frame + motion.damping * v_still)
        forces += (rule.alpha_m * mass * now.a + rule.alpha_f * before) / (1.0 - rule.alpha_f)
        stiffness = self.stiffness
        pull = still - forces / np.where(stiffness > 0.0, stiffness, 1.0)
        found = self._solve(scene, pull, now)
        if not found.converged:
            return found.reason
        a = (found.positions - still) / (rule.by_acceleration[1] * h**2)
        v = v_still + h * rule.to_velocity[1] * a
        springs = stiffness * (found.positions - pull)
        potential = found.energy - 0.5 * float(np.sum(springs * (found.positions - pull)))
        return _Moment(scene, found, frame, found.positions, v, a, -springs, springs, potential)

    def _solve(self, scene: Scene, pull: Floats, now: _Moment) -> Solution:
        """Solve from where the motion leads, or from where it is if no energy is finite there."""
        free = ~scene.dirichlet()[0]
        acting = np.where(free, now.gradient + self.stiffness * (now.x - pull), 0.0)
        self.scale = max(self.scale, float(np.linalg.norm(acting)))
        tolerance = self.motion.tolerance
        settle = partial(
            self.prepared.solve,
            self._with_springs(scene, pull),
            tolerance=tolerance,
            absolute=tolerance * self.scale or None,
        )
        found = settle(start=now.x + self.h * now.v)
        if found.reason is Reason.NOT_FINITE:
            found = settle(start=now.x)
        if scene is not now.scene:
            self.scale = max(self.scale, float(found.history.gradient_norm[0]))
        return found

    def _kinetic(self, now: _Moment) -> float:
        """v·M v / 2 [µJ]."""
        return 0.5 * float(np.sum(self.mass * now.v**2))

    def _dissipated(self, before: _Moment, now: _Moment) -> float:
        """The damper's work in a step [µJ], by the mean velocity."""
        v = 0.5 * (before.v + now.v)
        return self.h * self.motion.damping * float(np.sum(self.mass * v**2))

    def _put_in(self, before: _Moment, now: _Moment) -> float:
        """The work of the frame, held vertices and targets in a step [µJ], by the mean of their forces."""
        moved = now.x - before.x
        work = -0.5 * float(np.sum(self.mass * moved @ (before.frame + now.frame)))
        held = now.scene.dirichlet()[0]
        if np.any(moved[held]):
            work += 0.5 * float(np.sum(((self._reactions(before) + self._reactions(now)) * moved)[held]))
        for old, new in zip(before.scene.of(Target), now.scene.of(Target), strict=True):
            if new is not old:
                away = 0.5 * ((before.x + now.x)[new.vertices] - old.positions - new.positions)
                stiffness = np.broadcast_to(new.stiffness, len(new.vertices))
                work -= float(np.sum(stiffness[:, None] * away * (new.positions - old.positions)))
        return work

    def _reactions(self, now: _Moment) -> Floats:
        """The forces [mN] at held vertices, shape (n, 3): of the scene, of inertia and of the damper."""
        inertia = self.mass * (now.a + now.frame + self.motion.damping * now.v)
        return now.solution.reactions - now.springs + inertia


def _lump_masses(motion: Motion) -> Floats:
    """Share the mass of tets and skin among their vertices [kg], shape (n,)."""
    scene, skin = motion.scene, motion.skin
    a, b, c = (scene.vertices[skin[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    shares = np.repeat(motion.skin_density * areas / 3.0, 3)
    tissue = Inertia(motion.density, motion.time_step).lump(scene, motion.density)
    return tissue + np.bincount(skin.ravel(), shares, minlength=len(scene.vertices))


def _check(
    scene, time_step, steps, rule, density, skin, skin_density, damping, targets, fixed, scenes, acceleration,
    positions, velocities, keep, tolerance, on_step,
) -> Motion:  # fmt: skip
    if not isinstance(scene, Scene):
        raise SceneError(f"march: expected a Scene, got {type(scene).__name__}")
    if not len(scene.tets):
        raise SceneError("march: the scene has no tets")
    if scene.of(Inertia):
        raise SceneError("march: the scene has an Inertia term; mass is given by density and skin_density")
    if scene.of(RigidBody):
        raise SceneError("march: cannot model RigidBody; hold its vertices by Fixed")
    step = np.asarray(time_step, dtype=np.float64)
    if step.shape != () or not 0.0 < step <= LONGEST:
        raise SceneError(f"time_step: must be above 0 s and at most {LONGEST:g}, got {time_step!r}")
    try:
        MARCH_STEPS.check("steps", steps)
    except InputError as error:
        raise SceneError(str(error)) from None
    triangles = np.empty((0, 3), dtype=np.int64) if skin is None else np.asarray(skin)
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.issubdtype(triangles.dtype, np.integer):
        raise SceneError(f"skin: expected triangles of shape (k, 3), got {triangles.shape} of {triangles.dtype}")
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < len(scene.vertices)):
        raise SceneError(f"skin: a vertex is outside 0..{len(scene.vertices) - 1}")
    volume = _check_amounts("density", density, len(scene.tets))
    area = _check_amounts("skin_density", skin_density, len(triangles))
    if not (volume.any() or area.any()):
        raise SceneError("march: nothing has mass; give density, or skin and skin_density")
    if not (np.isfinite(damping) and damping >= 0.0):
        raise SceneError(f"damping: expected a finite number of at least 0 per second, got {damping!r}")
    if not 0.0 < tolerance < 1.0:
        raise SceneError(f"tolerance must lie between 0 and 1, got {tolerance}")
    for name, course in (("targets", targets), ("fixed", fixed), ("acceleration", acceleration)):
        if course is not None and not callable(course) and (np.ndim(course) == 0 or len(course) < steps):
            raise SceneError(f"{name}: expected values of {steps} steps, got shape {np.shape(course)}")
    if scenes is not None and not isinstance(scenes(0.0), Scene):
        raise SceneError("scenes: expected a function from time [s] to a Scene")
    vertices = np.arange(len(scene.vertices)) if keep is None else np.asarray(keep)
    if vertices.ndim != 1 or not np.issubdtype(vertices.dtype, np.integer):
        raise SceneError(f"keep: expected vertices of shape (k,), got shape {vertices.shape} of {vertices.dtype}")
    if vertices.size and not (vertices.min() >= 0 and vertices.max() < len(scene.vertices)):
        raise SceneError(f"keep: a vertex is outside 0..{len(scene.vertices) - 1}")
    if (int(steps) + 1) * 3 * len(vertices) > MARCH_VALUES.most:
        raise SceneError(
            f"steps: {steps:,} of {len(vertices):,} vertices are too much to record; name fewer by keep, or march in "
            f"parts: at most {MARCH_VALUES.most // 3:,} vertices times steps"
        )
    return Motion(
        scene, rule, float(step), int(steps), volume, triangles.astype(np.int64), area, float(damping),
        targets, fixed, scenes, acceleration,
        _check_points("positions", positions, scene.vertices),
        _check_points("velocities", velocities, 0.0 * scene.vertices),
        vertices, tolerance, on_step,
    )  # fmt: skip


def _check_amounts(name: str, values, count: int) -> Floats:
    """Return one number of at least 0 per element, shape (count,)."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), (count,)):
        raise SceneError(f"{name}: expected one number or shape ({count},), got shape {array.shape}")
    if not (np.isfinite(array).all() and (array >= 0.0).all()):
        raise SceneError(f"{name}: must be finite and at least 0")
    return np.broadcast_to(array, (count,))


def _check_points(name: str, values, default: Floats) -> Floats:
    points = np.array(default) if values is None else np.array(values, dtype=np.float64)
    if points.shape != default.shape or not np.isfinite(points).all():
        raise SceneError(f"{name}: expected finite values of shape {default.shape}, got shape {points.shape}")
    return points
