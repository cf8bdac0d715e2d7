"""Time marching: a scene through time by an implicit scheme, by finite elements, and what comes of it.

The solver's package is imported when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np

from ..lhm.base.checks import check_arguments
from ..lhm.base.errors import InputError, SceneError
from ..lhm.base.limits import MARCH_STEPS, MARCH_VALUES
from ..lhm.base.mesh import Floats, Ints
from .scene import Scene
from .solution import Reason
from .terms import Inertia

SOLVERS = ("fenicsx",)
MASSES = ("lumped", "consistent")
OPTIONS = ("element", "policy")
SCHEMES = ("implicit Euler", "Newmark", "generalised-alpha")

LONGEST = 1e6
"""A time step [s]: eleven days."""
Course: TypeAlias = Callable[[float], Floats] | Floats
"""A function of time [s], or its values at the steps' ends, first axis (steps,)."""


@dataclass(frozen=True)
class Scheme:
    """How displacement, velocity and acceleration at two times hang together, and where forces balance.

    u₁ = u₀ + h v₀ + h² (β₀ a₀ + β₁ a₁) and v₁ = v₀ + h (γ₀ a₀ + γ₁ a₁), with
    M (α_m a₀ + (1 - α_m) a₁) + α_f (C v₀ + f₀) + (1 - α_f) (C v₁ + f₁) = 0. `name` is for reports.
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
    vertices, shape (k + 1, kept, 3); `vertices` (kept,) are their numbers; iterations (k,) and factorisations (k,) per
    step. A step that failed is not among them.
    """

    time_step: float
    times: Floats
    positions: Floats
    velocities: Floats
    vertices: Ints
    energies: Energies
    iterations: Ints
    factorisations: Ints
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
    mass: str
    damping: tuple[float, float]
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
    mass: str = "lumped",
    damping: tuple[float, float] = (0.0, 0.0),
    targets: Course | None = None,
    fixed: Course | None = None,
    scenes: Callable[[float], Scene] | None = None,
    acceleration: Course | None = None,
    positions: Floats | None = None,
    velocities: Floats | None = None,
    keep: Ints | None = None,
    tolerance: float = 1e-8,
    on_step: OnStep | None = None,
    prepared: Any = None,
    **options,
) -> Trajectory:
    """March a scene through `steps` of `time_step` [s]: M a + C v + f(u) = 0 by an implicit scheme.

    scheme is a name of SCHEMES or a Scheme. Mass is `density` [kg/mm³] of the tets, one or one per tet, and
    `skin_density` [kg/mm²] of triangles `skin` (k, 3), one or one per triangle; "lumped" on nodes or "consistent" with
    the shape functions. damping (a [1/s], b [s]) is Rayleigh's C = a M + b K, K the tangent at rest, springs included.
    `targets` and `fixed` [mm] move the one Target and the one Fixed term, `acceleration` [mm/s²] is that of the frame
    that positions are measured in (a shaken head): functions of time, or arrays of one value per step. Else
    `scenes` gives the scene by time: it may differ in targets, held positions, loads, limits and volumes sought.
    positions [mm] and velocities [mm/s] are those at the start, shape (n, 3), default rest; keep (kept,) vertices are
    recorded, default all. tolerance: of the forces that act if nothing moves on in a step, the largest so far.
    Options of fenicsx: `element`, "P1" or "P2", and `policy`, its constants. What it has `prepared` for this scene
    lends element, mesh, forms and matrix; `prepared.march(...)` is short for it.

    Raises SceneError for what is out of range, a scene with Inertia (mass is given here) or no mass at all, and what
    the solver cannot model; MissingDependencyError if its packages are not installed.
    """
    if solver not in SOLVERS:
        raise SceneError(f"march: unknown solver {solver!r}; there are {', '.join(SOLVERS)}")
    rule = scheme if isinstance(scheme, Scheme) else Scheme.from_name(scheme, spectral_radius=spectral_radius)
    motion = _check(
        scene, time_step, steps, rule, density, skin, skin_density, mass, damping,
        targets, fixed, scenes, acceleration, positions, velocities, keep, tolerance, on_step,
    )  # fmt: skip
    if prepared is not None:
        if options:
            raise SceneError(f"march: what is prepared has its own {', '.join(options)}")
        return prepared.carry_out(motion)
    for option in options:
        if option not in OPTIONS:
            raise SceneError(f"march: solver {solver!r} has no option {option!r}; it has {', '.join(OPTIONS)}")
    return import_module(f".{solver}.prepared", __package__).carry_out(motion, **options)


def _check(
    scene, time_step, steps, rule, density, skin, skin_density, mass, damping, targets, fixed, scenes, acceleration,
    positions, velocities, keep, tolerance, on_step,
) -> Motion:  # fmt: skip
    if not isinstance(scene, Scene):
        raise SceneError(f"march: expected a Scene, got {type(scene).__name__}")
    if not len(scene.tets):
        raise SceneError("march: the scene has no tets")
    if scene.of(Inertia):
        raise SceneError("march: the scene has an Inertia term; mass is given by density and skin_density")
    step = np.asarray(time_step, dtype=np.float64)
    if step.shape != () or not 0.0 < step <= LONGEST:
        raise SceneError(f"time_step: must be above 0 s and at most {LONGEST:g}, got {time_step!r}")
    try:
        MARCH_STEPS.check("steps", steps)
    except InputError as error:
        raise SceneError(str(error)) from None
    if mass not in MASSES:
        raise SceneError(f"mass {mass!r}: there are {', '.join(MASSES)}")
    triangles = np.empty((0, 3), dtype=np.int64) if skin is None else np.asarray(skin)
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.issubdtype(triangles.dtype, np.integer):
        raise SceneError(f"skin: expected triangles of shape (k, 3), got {triangles.shape} of {triangles.dtype}")
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < len(scene.vertices)):
        raise SceneError(f"skin: a vertex is outside 0..{len(scene.vertices) - 1}")
    volume = _check_amounts("density", density, len(scene.tets))
    area = _check_amounts("skin_density", skin_density, len(triangles))
    if not (volume.any() or area.any()):
        raise SceneError("march: nothing has mass; give density, or skin and skin_density")
    rayleigh = np.asarray(damping, dtype=np.float64)
    if rayleigh.shape != (2,) or not (np.isfinite(rayleigh).all() and (rayleigh >= 0.0).all()):
        raise SceneError(f"damping: expected two finite numbers of at least 0, got {damping!r}")
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
        scene, rule, float(step), int(steps), volume, triangles.astype(np.int64), area, mass,
        (float(rayleigh[0]), float(rayleigh[1])), targets, fixed, scenes, acceleration,
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
