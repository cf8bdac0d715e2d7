"""Time marching: a scene through time by an implicit scheme, on any solver.

A step's acceleration is linear in where it ends, a₁ = (x₁ - still) / (β₁ h²), and mass is lumped at vertices. So the
balance of forces at its end is that of the scene with one spring more at each vertex that has mass: a step is a static
solve, prepared once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..lhm.base.checks import finite, number, one_of
from ..lhm.base.errors import SceneError, quote
from ..lhm.base.limits import MARCH_STEPS
from ..lhm.base.mesh import Floats, Ints, Surface
from .scene import Scene
from .solution import Reason, Solution
from .solve import prepare, solve
from .terms import Amount, Fixed, RigidBody, Target

SCHEMES = ("implicit Euler", "Newmark", "generalised-alpha")

LONGEST = 1e6
"""A time step [s]: eleven days."""


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
        latter with loss at high ones only; an impact on Contact may give these two energy. Raises SceneError for
        another name or radius.
        """
        one_of("scheme", name, SCHEMES, error=SceneError)
        radius = number("spectral_radius", spectral_radius, least=0.0, most=1.0, error=SceneError)
        if name == "implicit Euler":
            return cls(name, (0.0, 1.0), (0.0, 1.0))
        alpha_m = alpha_f = 0.0
        if name == "generalised-alpha":
            alpha_m, alpha_f = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        gamma = 0.5 - alpha_m + alpha_f
        beta = 0.25 * float(np.square(1.0 - alpha_m + alpha_f))
        return cls(name, (0.5 - beta, beta), (1.0 - gamma, gamma), alpha_m, alpha_f)


@dataclass(frozen=True, eq=False)
class Moment:
    """A scene at a time [s] of a march, and the solve that led there: with a spring at each mass, but for the first.

    velocities [mm/s] and accelerations [mm/s²] have shape (n, 3); `frame` [mm/s²], shape (3,), is the frame's. energy
    [µJ] and, where there is mass, gradient [mN], shape (n, 3), are the scene's without those springs.
    """

    time: float
    scene: Scene
    solution: Solution
    velocities: Floats
    accelerations: Floats
    frame: Floats
    energy: float
    gradient: Floats

    def copy(self) -> Moment:
        """Return the same with arrays of its own, for a caller to write to."""
        own = {name: getattr(self, name).copy() for name in ("velocities", "accelerations", "frame", "gradient")}
        return replace(self, solution=replace(self.solution, positions=self.positions.copy()), **own)

    @property
    def positions(self) -> Floats:
        """Where vertices are [mm], shape (n, 3)."""
        return self.solution.positions


def march(
    scene: Scene,
    *,
    time_step: float,
    steps: int,
    solver: str = "fenicsx",
    scheme: str | Scheme = "implicit Euler",
    density: float | Floats = 0.0,
    skin: Ints | None = None,
    skin_density: float | Floats = 0.0,
    damping: float = 0.0,
    scenes: Callable[[float], Scene] | None = None,
    acceleration: Callable[[float], Floats] | None = None,
    positions: Floats | None = None,
    velocities: Floats | None = None,
    tolerance: float = 1e-8,
    **options,
) -> Iterator[Moment]:
    """March a scene through `steps` of `time_step` [s]: M (a + c v) + f(x) = 0 by an implicit scheme.

    Yields the start and a moment per step; one whose forces do not balance is the last. scheme is a name of
    SCHEMES or a Scheme. Mass is `density` [kg/mm³] of the tets, one or one per tet, and `skin_density` [kg/mm²] of
    triangles `skin` (k, 3), one or one per triangle, lumped at vertices; vertices without mass follow in balance, from
    the start on. damping c [1/s] is by mass. `scenes` gives the scene by time [s]: it may differ in targets, held
    positions, loads, limits and volumes sought. `acceleration` [mm/s²] by time is that of the frame that positions are
    measured in (a shaken head). positions [mm] and velocities [mm/s] are those at the start, shape (n, 3), default
    rest. tolerance: of the forces that act if nothing moves on in a step, the largest so far. `options` are the
    solver's.

    Raises SceneError or InputError for what is out of range, a scene with RigidBody, or no mass at all, and what the
    solver cannot model; MissingDependencyError if its packages are not installed.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"march: expected a Scene, got {type(scene).__name__}")
    for name, function in (("scenes", scenes), ("acceleration", acceleration)):
        if function is not None and not callable(function):
            raise SceneError(f"{name}: expected a function of time [s], got {quote(function)}")
    if scene.of(RigidBody):
        raise SceneError("march: cannot model RigidBody; hold its vertices by Fixed")
    if (skin is None) == bool(np.any(skin_density)):
        raise SceneError("march: skin and skin_density need each other")
    mass = _lump_masses(scene, density, skin, skin_density)
    if not mass.any():
        raise SceneError("march: nothing has mass; give density, or skin and skin_density")
    x = scene.vertices if positions is None else positions
    v = 0.0 * scene.vertices if velocities is None else velocities
    marcher = _March(
        scene,
        scheme if isinstance(scheme, Scheme) else Scheme.from_name(scheme),
        number("time_step", time_step, above=0.0, most=LONGEST, unit="s", error=SceneError),
        mass,
        number("damping", damping, least=0.0, unit="per second", error=SceneError),
        scenes,
        acceleration,
        tolerance,
        solver,
        options,
    )
    return marcher.run(
        MARCH_STEPS.check("steps", steps),
        finite("positions", x, scene.vertices.shape, error=SceneError).copy(),
        finite("velocities", v, scene.vertices.shape, error=SceneError).copy(),
    )


class _March:
    """One march: springs of every step have one stiffness, so that a solver prepares once.

    mass [kg] is (n, 1); `scale` [mN] the largest forces so far that act if nothing moves on in a step.
    """

    def __init__(self, scene, rule, time_step, mass, damping, scenes, acceleration, tolerance, solver, options):
        self.scene, self.rule, self.h, self.mass, self.damping = scene, rule, time_step, mass, damping
        self.scenes, self.acceleration, self.tolerance = scenes, acceleration, tolerance
        self.heavy = np.flatnonzero(mass)
        by_mass = (1.0 - rule.alpha_m) / ((1.0 - rule.alpha_f) * rule.by_acceleration[1] * time_step**2)
        by_damping = damping * rule.to_velocity[1] / (rule.by_acceleration[1] * time_step)
        self.stiffness = (by_mass + by_damping) * mass
        self.prepared = prepare(self._with_springs(scene, scene.vertices), solver=solver, **options)
        self.solve_at_start: Callable[..., Solution] = partial(solve, solver=solver, tolerance=tolerance, **options)
        self.scale = 0.0

    def run(self, steps: int, x: Floats, v: Floats) -> Iterator[Moment]:
        """Make all steps from positions x and velocities v, or those up to one that fails."""
        now = self._start(x, v)
        yield now.copy()
        for step in range(1, steps + 1):
            now = self._step(now, step * self.h)
            yield now.copy()
            if not now.solution.is_balanced:
                return

    def _with_springs(self, scene: Scene, places: Floats) -> Scene:
        springs = Target(self.heavy, places[self.heavy], self.stiffness[self.heavy, 0])
        return replace(scene, terms=(*scene.terms, springs))

    def _at(self, time: float) -> tuple[Scene, Floats]:
        """Return the scene at a time, and the frame's acceleration [mm/s²], shape (3,)."""
        scene = self.scene if self.scenes is None else self.scenes(time)
        if not isinstance(scene, Scene):
            raise SceneError(f"scenes: expected a Scene at {time:g} s, got {type(scene).__name__}")
        frame = np.zeros(3) if self.acceleration is None else self.acceleration(time)
        return scene, finite("acceleration", frame, (3,), error=SceneError).copy()

    def _start(self, x: Floats, v: Floats) -> Moment:
        """Hold vertices with mass, let the others find their balance, and take accelerations from what is left."""
        scene, frame = self._at(0.0)
        held, places = scene.dirichlet()
        x = np.where(held, places, x)
        v = np.where(held & (self.scenes is None), 0.0, v)
        pinned = replace(scene, terms=(*scene.terms, Fixed(self.heavy, x[self.heavy])))
        found = self.solve_at_start(pinned, start=x)
        if not found.is_balanced:
            raise SceneError(f"march: the start has no balance of forces; {found.reason}")
        heavy = self.mass > 0.0
        gradient = np.where(heavy, found.reactions, 0.0)
        pulls = gradient / np.where(heavy, self.mass, 1.0) + frame + self.damping * v
        a = np.where(heavy & ~held, -pulls, 0.0)
        return Moment(0.0, scene, found, v, a, frame, found.energy, gradient)

    def _step(self, now: Moment, time: float) -> Moment:
        rule, h, mass = self.rule, self.h, self.mass
        scene, frame = self._at(time)
        still = now.positions + h * now.velocities + h**2 * rule.by_acceleration[0] * now.accelerations
        v_still = now.velocities + h * rule.to_velocity[0] * now.accelerations
        before = now.gradient + mass * (now.frame + self.damping * now.velocities)
        forces = mass * (frame + self.damping * v_still)
        forces += (rule.alpha_m * mass * now.accelerations + rule.alpha_f * before) / (1.0 - rule.alpha_f)
        pull = still - forces / np.where(self.stiffness > 0.0, self.stiffness, 1.0)
        found = self._solve(scene, pull, now)
        a = (found.positions - still) / (rule.by_acceleration[1] * h**2)
        v = v_still + h * rule.to_velocity[1] * a
        springs = self.stiffness * (found.positions - pull)
        energy = found.energy - 0.5 * float(np.sum(springs * (found.positions - pull)))
        return Moment(time, scene, found, v, a, frame, energy, -springs)

    def _solve(self, scene: Scene, pull: Floats, now: Moment) -> Solution:
        """Solve from where the motion leads, or from where it is if no energy is finite there."""
        free = ~scene.dirichlet()[0]
        acting = np.where(free, now.gradient + self.stiffness * (now.positions - pull), 0.0)
        self.scale = max(self.scale, float(np.linalg.norm(acting)))
        absolute = self.tolerance * self.scale or None
        settle = partial(
            self.prepared.solve, self._with_springs(scene, pull), tolerance=self.tolerance, absolute=absolute
        )
        found = settle(start=now.positions + self.h * now.velocities)
        if found.reason is Reason.NOT_FINITE:
            found = settle(start=now.positions)
        if scene is not now.scene:
            self.scale = max(self.scale, float(found.history.gradient_norm[0]))
        return found


def _lump_masses(scene: Scene, density, skin, skin_density) -> Floats:
    """Share the mass of tets and skin among their vertices [kg], shape (n, 1)."""
    n = len(scene.vertices)
    tissue = Amount(0.0).check("density", density, len(scene.tets)) * scene.volumes
    mass = np.bincount(scene.tets.ravel(), np.repeat(tissue / 4.0, 4), minlength=n)
    if skin is not None:
        surface = Surface(scene.vertices, skin)
        sheet = Amount(0.0).check("skin_density", skin_density, len(surface.triangles)) * surface.areas
        mass += np.bincount(surface.triangles.ravel(), np.repeat(sheet / 3.0, 3), minlength=n)
    return mass.astype(np.float64)[:, None]
