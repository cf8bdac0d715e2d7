"""prepare and solve on FEniCSx: mesh, forms and matrix once; Newton per call, in load steps where it must."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from ...lhm.checked import checked
from ...lhm.errors import SceneError
from ...lhm.mesh import Floats
from ..materials import Corotated, Incompressible, Material
from ..restraint import check_restrained
from ..scene import Scene, refuse_unknown
from ..solution import OnIteration, Reason, Recorder, Solution, stop_threshold, volume_ratio
from ..terms import (
    Bending,
    Fixed,
    Gravity,
    Hyperelastic,
    Inertia,
    Pressure,
    RigidBody,
    Strain,
    SurfaceStrain,
    Target,
    Traction,
    Volume,
)
from .balance import Balance, Descent
from .block_saddle import SADDLES
from .bodies import Pose, RigidProblem
from .condensed import Condensed
from .densities import DENSITIES
from .fields import Fields, Sampling
from .linear import LINEAR_SOLVERS
from .linear_start import compressible
from .load_path import PATH_TOLERANCE
from .mixed_densities import check_mixed
from .multipliers import MultiplierDescent, laws_of
from .newton import AnyState, Newton, Work
from .numbering import Numbering
from .problem import Problem, State
from .recovery import recover
from .shared_linear import solver_of
from .shares import problem_of

TERMS = (
    Hyperelastic,
    Strain,
    Volume,
    SurfaceStrain,
    Bending,
    Target,
    Fixed,
    RigidBody,
    Gravity,
    Traction,
    Pressure,
    Inertia,
)
LAWS: tuple[type[Material], ...] = (*DENSITIES, Corotated)
VARYING = {
    Target: ("positions",),
    Fixed: ("values",),
    Gravity: ("acceleration", "density"),
    Traction: ("vector",),
    Pressure: ("value",),
    Strain: ("limit", "growth"),
    Volume: ("target",),
    SurfaceStrain: ("growth",),
    RigidBody: ("rest",),
    Inertia: ("positions", "velocities"),
}
DEGREE_OF = {"P1": 1, "P2": 2, "P2P1": 2}
"""The degree of each element's displacement."""
MAX_ITERATIONS = 100
SMALLEST_FRACTION = 1 / 64  # of the motion of the held vertices, in one load step
LOAD_STEP_TOLERANCE = 1e-2
STRAIGHT_ITERATIONS = 10  # beyond them descent may have left the path that the load grows along
ROUNDING = 1e-14  # of the largest coordinate: closer to its goal, what is held has arrived
FORCE_DEGREE = 6
LARGE = 10_000  # tets, from which on Newton's steps with a pressure are dear enough to descend at once
# Terms whose energy may lose stiffness in directions that cost nothing, and those that the load path has no room for.
INDEFINITE = (Strain, Volume, SurfaceStrain, Bending, RigidBody)
GIVEN_UP = (Reason.LINE_SEARCH, Reason.LINEAR_SOLVER)


@checked
def prepare(scene: Scene, *, element: str = "P1", linear_solver: str = "cg") -> PreparedFenicsx:
    """Make mesh, forms (compiled once per kind of scene, then cached on disk) and the matrix' pattern.

    element is "P1", "P2", or "P2P1" of quadratic displacement and linear pressure, for (nearly) incompressible laws.
    linear_solver is "cg" (conjugate gradients with algebraic multigrid, for large scenes) or "mumps" (direct). By
    element "P2P1" "cg" is by size: factors below LARGE_SADDLE unknowns, above them GMRES with a block preconditioner,
    which "block" asks for whatever the size. The load path (`Balance`: follower pressure, and where descent gives up)
    always takes factors, whose inertia it needs. Raises SceneError for another element or linear solver, for a term
    that this solver cannot model, and for a law that the element cannot.
    """
    if element not in DEGREE_OF:
        raise SceneError(f"solver 'fenicsx': unknown element {element!r}; there are {', '.join(DEGREE_OF)}")
    _check_terms(scene, element)
    return PreparedFenicsx(scene, element, linear_solver)


def _check_terms(scene: Scene, element: str):
    if not len(scene.tets):
        raise SceneError("solver 'fenicsx': the scene has no tets")
    refuse_unknown(scene, "fenicsx", TERMS, (*LAWS, Incompressible))
    for term in scene.of(Hyperelastic):
        if element == "P2P1":
            check_mixed(term.material)
        elif isinstance(term.material, Incompressible):
            raise SceneError(f"solver 'fenicsx' cannot model Incompressible by element {element!r}; 'P2P1' models it")
    if element == "P2P1" and scene.of(Volume):
        raise SceneError("element 'P2P1' cannot model Volume by a pressure; element 'P2' models it")
    if element == "P2P1" and not scene.of(Hyperelastic):
        raise SceneError("element 'P2P1' needs a Hyperelastic term for its pressure; element 'P2' does without")
    if scene.of(RigidBody) and (element == "P2P1" or scene.of(Pressure)):
        raise SceneError("solver 'fenicsx' cannot model RigidBody with element 'P2P1' or Pressure; fix its vertices")


class PreparedFenicsx:
    """See `softdeca.reference.Prepared`; `detail` of a solution counts linear iterations and solves, and assemblies."""

    def __init__(self, scene: Scene, element: str, linear: str):
        known = SADDLES if element == "P2P1" else tuple(LINEAR_SOLVERS)
        if linear not in known:
            names = ", ".join(known)
            raise SceneError(f"solver 'fenicsx': unknown linear_solver {linear!r}; there are {names}")
        self.scene = scene
        self._numbering = Numbering(scene, DEGREE_OF[element])
        if element == "P2P1":
            self._problem = Problem(scene, self._numbering, mixed=True)
        else:
            self._problem = problem_of(scene, self._numbering)
        self._linear_solver = linear
        self._linear = solver_of("cg" if linear == "block" else linear, self._problem.matrix)
        self._direct = solver_of("mumps", self._problem.matrix)
        self._rigid = None
        if scene.of(RigidBody):
            self._rigid = RigidProblem(scene, self._numbering, self._problem)
            self._rigid_linear = solver_of(linear, self._rigid.matrix)
            self._rigid_direct = solver_of("mumps", self._rigid.matrix)
        self._force: Floats | None = None
        self._end: _Solve | Balance | MultiplierDescent | None = None
        self._balances = element == "P2P1" or bool(scene.of(Pressure))
        self._condensed = None
        if element == "P2P1" and not scene.of(Pressure):
            self._condensed = Condensed(self._problem, laws_of(self._problem, scene))
        # A body of elastic tissue alone, pulled at its surface, may be in equilibrium and yet unstable.
        self._may_snap = bool(scene.of(Traction)) and not any(scene.of(kind) for kind in INDEFINITE)

    @checked
    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = 1e-6,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Solution:
        """Solve the prepared scene, or one that differs only in targets, held positions, loads and target volumes.

        The first gradient norm, to which tolerance relates, includes the forces that the held vertices' motion causes.
        See `softdeca.reference.Prepared.solve`.
        """
        scene = self.scene if scene is None else scene
        solution = self._solve(scene, start, tolerance, max_iterations, on_iteration)
        assert self._end is not None
        recovery = partial(recover, scene, self._numbering.degree, *self._end.end, self._force)
        return replace(solution, recovery=recovery)

    def _solve(
        self,
        scene: Scene,
        start: Floats | None,
        tolerance: float,
        max_iterations: int | None,
        on_iteration: OnIteration | None,
    ) -> Solution:
        self.scene.check_prepared_for(scene, varying=VARYING)
        begin = _checked_start(scene, start)
        limit = MAX_ITERATIONS if max_iterations is None else max_iterations
        if not 0.0 < tolerance < 1.0:
            raise SceneError(f"tolerance must lie between 0 and 1, got {tolerance}")
        if limit < 0:
            raise SceneError(f"max_iterations must be at least 0, got {limit}")
        self._problem.set(scene)
        if self._force is not None:
            self._problem.loads = self._problem.loads + self._force
        check_restrained(scene, loads=None if self._balances else scene.loads())

        def balance(descent: Descent | None = None) -> Balance:
            numbering, problem = self._numbering, self._problem
            return Balance(scene, numbering, problem, begin, tolerance, max_iterations, on_iteration, descent)

        if self._condensed is not None:
            large = len(scene.tets) >= LARGE
            descent = MultiplierDescent(
                scene,
                self._numbering,
                self._condensed,
                self._linear_start(scene) if large and start is None else begin,
                tolerance,
                max_iterations,
                on_iteration,
                warm=start is not None,
                linear_solver=self._linear_solver,
            )
            path_first = (bool(scene.of(Traction)) or not large) and self._linear_solver != "block"
            loaded = bool(self._problem.loads.any())
            return self._either(descent, balance(descent.settle), path_first=path_first, loaded=loaded)
        if self._balances:
            path = balance()
            self._end = path
            return path.run()
        poses: list[Pose] = []
        if self._rigid is not None:
            self._rigid.set(scene)
            poses = self._rigid.rest() if start is None else self._rigid.nearest(self._numbering.to_dofs(begin))
        solve = _Solve(self, scene, begin, poses, tolerance, limit, on_iteration)
        self._end = solve
        solution = solve.run()
        doubtful = self._may_snap and solution.converged
        if not doubtful and (solution.reason not in GIVEN_UP or self._rigid is not None):
            return solution
        path = balance(solve.settle)
        stable = doubtful and path.stable(solve.end[0])
        if stable and solution.iterations <= STRAIGHT_ITERATIONS:
            return solution
        followed = path.run()
        if stable and followed.reason in GIVEN_UP:  # a start that is no equilibrium without load begins no path
            return solution
        self._end = path
        return followed

    def _linear_start(self, scene: Scene) -> Floats:
        """Positions (n, 3) [mm] from linear tets of compressible tissue, or at rest where they find none."""
        near = PreparedFenicsx(compressible(scene), "P1", "cg").solve(tolerance=LOAD_STEP_TOLERANCE)
        sound = near.converged and near.volume_ratio.min() > 0.0
        return near.positions if sound else scene.vertices

    def _either(self, descent: MultiplierDescent, balance: Balance, *, path_first: bool, loaded: bool) -> Solution:
        """Descend or follow the load path, and the other one where the first gives up or finds a limit without load."""
        first, second = (balance, descent) if path_first else (descent, balance)
        self._end = first
        solution = first.run()
        if solution.reason not in GIVEN_UP and (loaded or solution.reason is not Reason.LIMIT_POINT):
            return solution
        again = second.run()
        if again.reason in GIVEN_UP:
            return solution
        self._end = second
        return again

    def set_body_force(self, density: Callable[[Floats], Floats]):
        """Load every later solve by a force per rest volume [mN/mm³]: (q, 3) at places (q, 3) [mm], for studies."""
        sampling = Sampling(self._numbering, FORCE_DEGREE)
        self._force = sampling.load(density(sampling.X))

    def fields(self, degree: int) -> Fields:
        """The last solve's finite-element functions at the points of a quadrature rule; SceneError before a solve."""
        if self._end is None:
            raise SceneError("fields: nothing is solved yet")
        u, pressure = self._end.end
        at_cells = None if pressure is None else pressure[self._problem.pressure_dofs]
        return Sampling(self._numbering, degree).fields(u, at_cells)


def _checked_start(scene: Scene, start: Floats | None) -> Floats:
    start = scene.vertices if start is None else np.asarray(start, dtype=np.float64)
    if start.shape != scene.vertices.shape or not np.isfinite(start).all():
        raise SceneError(f"start: expected finite positions of shape {scene.vertices.shape}, got shape {start.shape}")
    return start


class _Solve:
    """One call of solve: from start towards the held positions, in as few load steps as keep the energy finite.

    Rigid bodies are brought to their first poses like held vertices, and set free once all that is held is in place.
    """

    def __init__(
        self,
        prepared: PreparedFenicsx,
        scene: Scene,
        start: Floats,
        poses: list[Pose],
        tolerance: float,
        limit: int,
        on_iteration,
    ):
        self._numbering, self._problem = prepared._numbering, prepared._problem
        self._scene, self._tolerance, self._limit = scene, tolerance, limit
        held, positions = scene.dirichlet()
        self._elsewhere = np.where(held, positions, start)
        held = self._numbering.held(held)
        self._u = self._numbering.to_dofs(start) - self._numbering.X
        self._goal = np.where(held, self._numbering.to_dofs(positions) - self._numbering.X, self._u)
        held = held | self._problem.unsupported[:, None]
        self._recorder = Recorder(on_iteration)
        self._assemblies = self._problem.assemblies
        rigid, self._work = prepared._rigid, Work()
        if rigid is not None:
            linear = prepared._rigid_linear, prepared._rigid_direct
            self._freed = Newton(rigid, rigid.held(held), *linear, self._report, self._work)
            held[rigid.nodes] = True
            places = self._numbering.X + self._goal
            rigid.place(poses, places)
            self._goal[rigid.nodes] = (places - self._numbering.X)[rigid.nodes]
        near = np.abs(self._goal - self._u) <= ROUNDING * np.abs(self._numbering.X).max(initial=1.0)
        self._goal[near] = self._u[near]
        self._rigid, self._poses = rigid, poses
        linear = prepared._linear, prepared._direct
        self._newton = Newton(self._problem, np.flatnonzero(held), *linear, self._report, self._work)

    def settle(self, u: Floats, p: Floats) -> tuple[Floats, Floats, Reason, int]:
        """See `balance.Descent`: what is held stays where it is."""
        state = self._at(u)
        if not np.isfinite(state.energy):
            return u, p, Reason.NOT_FINITE, 0
        end, reason, made = self._newton.minimise(
            state, threshold=lambda first: PATH_TOLERANCE * first, max_iterations=self._limit
        )
        return end.u, p, reason, made

    def _positions(self, u: Floats) -> Floats:
        return self._numbering.to_scene(self._numbering.X + u, self._elsewhere)

    def _at(self, u: Floats) -> State:
        self._work.energies += 1
        return self._problem.at(u)

    def _report(self, state: AnyState, norm: float) -> bool:
        return self._recorder.record(self._positions(state.u), state.energy, norm)

    def run(self) -> Solution:
        """Lift, take load steps if need be, and minimise."""
        state = self._at(self._u)
        if not np.isfinite(state.energy):
            self._report(state, np.inf)
            return self._solution(state, Reason.NOT_FINITE, 0)
        iterations = 0
        while True:
            lifted, fraction, force = self._lift(state)
            if lifted is None:
                return self._solution(state, Reason.LINE_SEARCH, iterations)
            tolerance = self._tolerance if fraction == 1.0 else LOAD_STEP_TOLERANCE

            def threshold(first: float, force: float = force, tolerance: float = tolerance) -> float:
                return stop_threshold(self._scene, max(first, force), tolerance)

            newton, begin = self._newton, cast(AnyState, lifted)
            if fraction == 1.0 and self._rigid is not None:
                newton, begin = self._freed, self._rigid.at(lifted.u, self._poses)
            end, reason, made = newton.minimise(begin, threshold=threshold, max_iterations=self._limit - iterations)
            iterations += made
            if fraction == 1.0 or reason is not Reason.CONVERGED:
                return self._solution(end, reason, iterations)
            state = cast(State, end)

    def _lift(self, state: State) -> tuple[State | None, float, float]:
        """Move held dofs towards their goal while the energy stays finite; give the state, how far, and the force."""
        jump = np.zeros_like(state.u)
        held = self._newton.held
        jump.flat[held] = self._goal.flat[held] - state.u.flat[held]
        if not jump.any():
            return state, 1.0, 0.0
        spread, force = self._newton.extension(state, jump)
        fraction = 1.0
        while fraction >= SMALLEST_FRACTION:
            u = state.u + fraction * spread
            if fraction == 1.0:
                u.flat[held] = self._goal.flat[held]
            lifted = self._at(u)
            if np.isfinite(lifted.energy):
                return lifted, fraction, fraction * force
            fraction *= 0.5
        return None, 0.0, 0.0

    def _solution(self, state: AnyState, reason: Reason, iterations: int) -> Solution:
        self.end = state.u, None
        positions = self._positions(state.u)
        held, values = self._scene.dirichlet()
        if reason is Reason.CONVERGED:
            positions[held] = values[held]
        work = self._work
        detail: dict[str, float] = {
            "linear_iterations": work.linear_iterations,
            "linear_solves": work.linear_solves,
            "fallback_solves": work.fallback_solves,
            "assemblies": self._problem.assemblies - self._assemblies,
            "energies": work.energies,
        }
        return Solution(
            positions,
            reason,
            iterations,
            state.energy,
            self._recorder.history(),
            volume_ratio(self._scene, positions),
            detail,
        )
