"""prepare and solve for projective dynamics: statics of the PD energies."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from ...lhm.errors import SceneError
from ...lhm.geometry.factor import LinearSolver
from ...lhm.mesh import Floats
from ..scene import Scene, refuse_unknown
from ..solution import OnIteration, Reason, Recorder, Solution, stop_threshold, volume_ratio
from ..terms import (
    Bending,
    Contact,
    Fixed,
    Gravity,
    Inertia,
    RigidBody,
    Strain,
    StrainRule,
    SurfaceStrain,
    Target,
    Term,
    Traction,
    Volume,
)
from .coordinates import Coordinates, Place
from .descent import Descent, Point, Problem, Watch, after_untangling, anderson, lbfgs, plain
from .energy import Energy
from .memory import Memory
from .system import System

if TYPE_CHECKING:
    from .contact import Following

Method = Literal["lbfgs", "anderson", "plain"]
METHODS: dict[str, Descent] = {
    "lbfgs": partial(after_untangling, lbfgs),
    "anderson": partial(after_untangling, anderson),
    "plain": plain,
}
TERMS: tuple[type[Term], ...] = (
    Strain,
    Volume,
    SurfaceStrain,
    Bending,
    Target,
    Fixed,
    RigidBody,
    Gravity,
    Traction,
    Inertia,
    Contact,
)
VARYING: dict[type[Term], tuple[str, ...]] = {
    Strain: ("limit", "growth"),
    Volume: ("target",),
    SurfaceStrain: ("growth",),
    Target: ("positions",),
    Fixed: ("values",),
    Gravity: ("acceleration", "density"),
    Traction: ("vector",),
    Inertia: ("positions", "velocities"),
}
# The share of Volume's weight in the matrix (see `Energy.matrix`). For L-BFGS 0.15 to 0.5 do about as well: on three
# expressions of a head 54, 29 and 39 iterations to 0.01 mm instead of 77, 49 and 60 with a share of 1.
VOLUME_SHARE: dict[Method, float] = {"lbfgs": 0.3, "anderson": 1.0, "plain": 1.0}
MAX_ITERATIONS = 5000


@dataclass
class _Work:
    """Evaluates energies over the unknowns and solves with A, and counts both."""

    system: System
    evaluations: int = 0
    global_solves: int = 0

    def on(self, energy: Energy) -> Callable[[Place], Point]:
        def at(place: Place) -> Point:
            self.evaluations += 1
            value, gradient = energy.evaluate(place.u)
            return Point(place, value, self.system.coordinates.pull(gradient, place))

        return at

    def precondition(self, vector: Floats, point: Point) -> Floats:
        self.global_solves += 1
        return self.system.solve(vector, point.place.rotations)

    def counts(self) -> dict[str, float]:
        return {
            "factorisations": float(len(self.system.groups)),
            "evaluations": float(self.evaluations),
            "global_solves": float(self.global_solves),
        }


@dataclass(frozen=True, eq=False)
class ProjectiveSolution(Solution):
    """A solution with what L-BFGS remembers of the energy, from which that of a scene nearby may start."""

    memory: Memory | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class ProjectivePrepared:
    """A scene with its PD matrix factored; see `reference.solve.Prepared`."""

    scene: Scene
    method: Method
    energy: Energy
    system: System
    contact: Following | None

    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = 1e-6,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
        warm: Solution | None = None,
        remember: bool = False,
        untangle: bool = True,
    ) -> ProjectiveSolution:
        """Minimise the energy of the prepared scene, or of one that differs only in the fields of `VARYING`.

        start [mm], shape (n, 3), default rest; `warm` is the solution of the frame before, which gives the default
        start and, if it was to `remember` them (16 numbers per unknown), the pairs of steps and changes that L-BFGS
        begins with. What is Fixed is put where it is held, and a RigidBody where it fits best, before the first
        iteration. A start with inverted tets is untangled first, unless it is known to need none: not to `untangle` one
        near the answer saves half the iterations.
        Nothing is factored again. `detail` counts factorisations, evaluations and global solves; with Contact in the
        scene also crossing pairs of triangles and the greatest depth [mm] before and after, and rounds.
        Raises SceneError if `scene` needs a new preparation, if start or tolerance are out of range, or if loads push
        a part that nothing holds.
        """
        scene = self.scene if scene is None else scene
        self.scene.check_prepared_for(scene, varying=VARYING)
        limit = _checked_limits(tolerance, max_iterations)
        held, values = scene.dirichlet()
        coordinates = self.system.coordinates
        place = coordinates.start(np.where(held, values, _checked_start(scene, start, warm)) - scene.vertices)
        recorder = Recorder(on_iteration)
        energy = self.energy.for_scene(scene)
        self.system.check_loads(energy.loads)
        work = _Work(self.system)
        tangled = untangle and bool((volume_ratio(scene, scene.vertices + place.u) <= 0).any())
        untangling = work.on(energy.untangling(VOLUME_SHARE[self.method])) if tangled else None
        bounded, memory = energy.bending is None, self._remembered(warm)
        problem = Problem(work.on(energy), coordinates.move, work.precondition, untangling, bounded, memory)
        first = problem.at(place)
        watch = Watch(recorder, scene.vertices, stop_threshold(scene, first.norm, tolerance), limit)
        point, reason = METHODS[self.method](problem, first, watch)
        if reason is Reason.STAGNATED and watch.best is not None:
            point = watch.best
        outcome: dict[str, float] = {}
        if self.contact is not None and reason in (Reason.CONVERGED, Reason.STAGNATED):
            point, reason, outcome = self.contact.solve(problem, point, scene.vertices, watch)
        positions = np.where(held, values, scene.vertices + point.u)
        return ProjectiveSolution(
            positions=positions,
            reason=reason,
            iterations=watch.iteration,
            energy=point.energy,
            history=recorder.history(),
            volume_ratio=volume_ratio(scene, positions),
            detail=work.counts() | outcome,
            memory=memory if remember else None,
        )

    def _remembered(self, warm: Solution | None) -> Memory | None:
        """A memory of its own for a solve, of what a solution of as many unknowns left."""
        if self.method != "lbfgs":
            return None
        left = warm.memory if isinstance(warm, ProjectiveSolution) else None
        size = self.system.coordinates.size
        return Memory(size) if left is None or left.size != size else left.copy()


def prepare(
    scene: Scene,
    *,
    method: Method = "lbfgs",
    linear_solver: LinearSolver | None = None,
    like: ProjectivePrepared | None = None,
    threads: int = 1,
) -> ProjectivePrepared:
    """Factor the PD matrix of a scene.

    method is "lbfgs", "anderson" (both accelerated) or "plain" (local/global). linear_solver is "cholespy" (the
    default; BSD-3), "superlu" (SciPy's, BSD-3) or "cholmod" (the system's, LGPL and GPL): see `lhm.geometry.factor`.
    With "cholmod", a scene prepared `like` another of the same topology, such as another identity, takes over its
    symbolic factorisation. `threads` share the local step. Terms: Strain, Volume, SurfaceStrain, Bending, Target,
    Fixed, RigidBody, Gravity, Traction, Inertia, Contact. Raises SceneError for another term, method or count,
    InputError for another linear solver and MissingDependencyError for one that is not installed.
    """
    if method not in get_args(Method):
        raise SceneError(f"projective: unknown method {method!r}; there are {', '.join(get_args(Method))}")
    refuse_unknown(scene, "projective", TERMS, rules=get_args(StrainRule))
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
        raise SceneError(f"projective: threads must be at least 1, got {threads!r}")
    energy = Energy.of(scene, threads)
    matrix, anchored = energy.matrix(scene, volume_share=VOLUME_SHARE[method])
    known = None if like is None else like.system
    system = System.of(matrix, anchored, Coordinates.of(scene), linear_solver=linear_solver, like=known)
    return ProjectivePrepared(scene, method, energy, system, _following(scene, system))


def _following(scene: Scene, system: System) -> Following | None:
    """What solves for contact, where the scene has any."""
    if not scene.of(Contact):
        return None
    from .contact import Following

    return Following.of(scene, system)


def local_step_seconds(prepared: ProjectivePrepared, *, repeats: int = 20) -> float:
    """Median processor time [s] of one energy and gradient of all tets (the fused local step), slightly deformed."""
    tets = prepared.energy.tets
    if tets is None:
        raise SceneError("the scene has no Strain or Volume term to time")
    u = 0.01 * prepared.scene.vertices[:, [1, 2, 0]]
    gradient = np.zeros_like(u)
    tets.add_to(u, gradient)
    times = []
    for _ in range(repeats):
        begin = time.thread_time()
        tets.add_to(u, gradient)
        times.append(time.thread_time() - begin)
    return float(np.median(times))


def _checked_limits(tolerance: float, max_iterations: int | None) -> int:
    if not (np.isfinite(tolerance) and 0.0 < tolerance < 1.0):
        raise SceneError(f"tolerance: expected a number in (0, 1), got {tolerance}")
    if max_iterations is not None and max_iterations < 0:
        raise SceneError(f"max_iterations: must be at least 0, got {max_iterations}")
    return MAX_ITERATIONS if max_iterations is None else int(max_iterations)


def _checked_start(scene: Scene, start: Floats | None, warm: Solution | None) -> Floats:
    if start is None and warm is not None:
        start = warm.positions
    positions = np.array(scene.vertices if start is None else start, dtype=np.float64)
    if positions.shape != scene.vertices.shape:
        raise SceneError(f"start: expected shape {scene.vertices.shape}, got {positions.shape}")
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if bad.size:
        raise SceneError(f"start: {bad.size} rows are not finite, the first is {bad[0]}")
    return positions
