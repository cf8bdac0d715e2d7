"""prepare and solve on FEniCSx: mesh, forms and matrix once; a plan of strategies per call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...lhm.base.checks import check_arguments
from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from ..clock import Clock
from ..march import Motion, Trajectory, march
from ..materials import Incompressible, NeoHookean
from ..ranks import Mirrored, followers
from ..restraint import check_restrained
from ..scene import Scene, refuse_unknown
from ..solution import Limits, OnIteration, Solution, first_positions
from ..terms import (
    Hyperelastic,
    Pressure,
    RigidBody,
    Term,
    Traction,
    Volume,
)
from .bodies import Pose, RigidProblem
from .dolfinx_version import ALONE
from .dynamics import March, bare, check
from .fields import Fields, Sampling
from .hyperelastic import check_mixed
from .linear import LINEAR_SOLVERS, LinearSolver, Mumps
from .load_path import Continuation
from .minimise import LOAD_STEP_TOLERANCE, Minimisation
from .multipliers import Condensed, MultiplierDescent
from .numbering import Numbering
from .plan import BODIES, DISPLACEMENT, FOLLOWER_PRESSURE, Plan, follow, mixed
from .problem import Problem
from .recovery import Nodal, recover
from .run import Attempt, Record, Run
from .saddle import LARGE_SADDLE, SADDLES
from .scope import DEGREE_OF, LAWS, TERMS, processes_for, refuse_in_parts
from .shared import anywhere, check_same, gathered

FORCE_DEGREE = 6
BULK = 10.0  # lmbda by mu of a large scene's start: volumes are nearly kept, linear tets do not lock yet
STIFF = 4000.0
"""(2 mu + lmbda) / mu of a law, Poisson's ratio .49987, from which on CG's answer to a share of the forces is far off.

By P2 on a block of 2,187 unknowns, stretched by a fifth, MUMPS takes 9 iterations and .5 CPU s at .4999, CG 11 and
3.1 s; at .49999 MUMPS 23 and 1.6 s, where CG creeps. At .49 on 10,125 unknowns both take 1.5 s.
"""
LARGE = 10_000  # tets, from which on Newton's steps with a pressure are dear enough to descend at once


@check_arguments
def prepare(scene: Scene, *, element: str = "P1", linear_solver: str = "cg") -> PreparedFenicsx | MirroredFenicsx:
    """Make mesh, forms (compiled once per kind of scene, then cached on disk) and the matrix' pattern.

    element is "P1", "P2", or "P2P1" of quadratic displacement and linear pressure, for (nearly) incompressible laws.
    linear_solver is "cg" (conjugate gradients with algebraic multigrid, for large scenes) or "mumps" (direct), which
    "cg" is too for nearly incompressible laws (see STIFF) below LARGE_SADDLE unknowns. By element "P2P1" "cg" is by
    size: factors below LARGE_SADDLE unknowns, above them GMRES with a block preconditioner,
    which "block" asks for whatever the size. `Continuation` (follower pressure, and where descent gives up) always
    takes factors, whose inertia it needs. Raises SceneError for another element or linear solver, for a term that this
    solver cannot model, and for a law that the element cannot.
    """
    if element not in DEGREE_OF:
        raise SceneError(f"solver 'fenicsx': unknown element {element!r}; there are {', '.join(DEGREE_OF)}")
    _check_terms(scene, element)
    known = SADDLES if element == "P2P1" else tuple(LINEAR_SOLVERS)
    if linear_solver not in known:
        names = ", ".join(known)
        raise SceneError(f"solver 'fenicsx': unknown linear_solver {linear_solver!r}; there are {names}")
    others = followers()
    if others is None or processes_for(scene).size == 1:
        return PreparedFenicsx(scene, element, linear_solver)
    return MirroredFenicsx(Mirrored(others, PreparedFenicsx, scene, element, linear_solver), scene)


def _check_terms(scene: Scene, element: str):
    if not len(scene.tets):
        raise SceneError("solver 'fenicsx': the scene has no tets")
    refuse_unknown(scene, "fenicsx", TERMS, (*LAWS, Incompressible))
    refuse_in_parts(scene)
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

    def __init__(self, scene: Scene, element: str, linear: str, *, alone: bool = False):
        clock = Clock()
        self.scene, self._element, self._linear_solver = scene, element, linear
        self.comm = ALONE if alone else processes_for(scene)
        check_same(self.comm, scene)
        self._numbering = Numbering(scene, DEGREE_OF[element], comm=self.comm)
        self._large = self.comm.allreduce(len(self._numbering.tet)) >= LARGE
        self._problem = Problem(scene, self._numbering, mixed=element == "P2P1")
        make = LINEAR_SOLVERS[self._kind(linear)]
        self._linear, self._direct = make(self._problem.matrix), Mumps(self._problem.matrix)
        self._rigid: tuple[RigidProblem, LinearSolver, LinearSolver] | None = None
        if scene.of(RigidBody):
            rigid = RigidProblem(scene, self._numbering, self._problem)
            self._rigid = rigid, make(rigid.matrix), Mumps(rigid.matrix)
        self._condensed = None
        if element == "P2P1" and not scene.of(Pressure):
            self._condensed = Condensed(self._problem)
        self._force: Floats | None = None
        self._end: Attempt | None = None
        self._spent = clock.read()

    def _kind(self, linear: str) -> str:
        """The linear solver of Newton's steps by displacement: factors where multigrid leaves too much of volumes."""
        stiff = any(t.material.stiffness > STIFF * t.material.shear_modulus for t in self.scene.of(Hyperelastic))
        if linear == "cg" and stiff and 3 * self._numbering.nodes.total < LARGE_SADDLE:
            return "mumps"
        return "cg" if linear == "block" else linear

    @check_arguments
    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        warm: Solution | None = None,
        remember: bool = False,
        tolerance: float = 1e-6,
        absolute: float | None = None,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Solution:
        """Solve the prepared scene, or one that differs only in what terms say is `varying`.

        A solution that was to be remembered has the displacement of nodes on edges and the pressure to start from. The
        first gradient norm, to which tolerance relates, includes the forces that the held vertices' motion causes.
        See `softdeca.reference.Prepared.solve`.
        """
        record = Record(max_iterations, on_iteration)
        scene = self.scene if scene is None else scene
        check_same(self.comm, scene)
        self.scene.check_prepared_for(scene)
        begin, limits = first_positions(scene, start, warm), Limits(tolerance, absolute, max_iterations)
        before = None if start is not None or warm is None else warm.memory
        if not (isinstance(before, Attempt) and before.numbering is self._numbering):
            before = None
        self._set(scene)
        without_energy = self._element == "P2P1" or bool(scene.of(Pressure))
        check_restrained(scene, loads=None if without_energy else scene.loads())
        not_at_rest = start is not None or warm is not None
        run = Run(scene, self._numbering, begin, limits, record, before=before, warm=not_at_rest)
        self._end = follow(self._plan(scene), lambda strategy: self._attempt(strategy, run))
        recovery = partial(recover, scene, self._numbering.degree, self._nodal(self._end))
        return replace(run.solution(self._end, self._spent, remember=remember), recovery=recovery)

    def march(self, **course: Any) -> Trajectory:
        """The prepared scene through time, on its mesh, forms and matrix; see `softdeca.reference.march`."""
        return march(self.scene, prepared=self, **course)

    def carry_out(self, motion: Motion, *, own: Motion | None = None) -> Trajectory:
        """A motion of the prepared scene; `own` is the same with what only this process has, if there is such."""
        motion = motion if own is None else own
        check(motion, self._element)
        return March(motion, self._problem).run()

    def _plan(self, scene: Scene) -> Plan:
        if self._condensed is not None:
            path_first = (bool(scene.of(Traction)) or not self._large) and self._linear_solver != "block"
            return mixed(path_first=path_first, loaded=bool(self._problem.loads.any()))
        if scene.of(Pressure):
            return FOLLOWER_PRESSURE
        return BODIES if self._rigid is not None else DISPLACEMENT

    def _attempt(self, strategy: str, run: Run) -> Attempt:
        if strategy == "continuation":
            return self._continuation(run).attempt()
        if strategy == "minimise":
            return self._minimisation(run).attempt()
        return self._descent(self._from_linear(run) if self._large and not run.warm else run).attempt()

    def _minimisation(self, run: Run) -> Minimisation:
        poses: list[Pose] = []
        if self._rigid is not None:
            rigid = self._rigid[0]
            rigid.set(run.scene)
            poses = rigid.nearest(self._numbering.to_dofs(run.start)) if run.warm else rigid.rest()
        return Minimisation(run, self._problem, self._linear, self._direct, self._rigid, poses)

    def _descent(self, run: Run) -> MultiplierDescent:
        assert self._condensed is not None
        return MultiplierDescent(run, self._condensed, linear_solver=self._linear_solver)

    def _continuation(self, run: Run) -> Continuation:
        """The load path, with a descent for where a part of the body may have snapped."""
        if run.scene.of(Pressure):
            return Continuation(run, self._problem)
        descent = self._descent(run) if self._condensed is not None else self._minimisation(run)
        return Continuation(run, self._problem, descent.settle)

    def _set(self, scene: Scene):
        self._problem.set(scene)
        if self._force is not None:
            self._problem.loads = self._problem.loads + self._force

    def _from_linear(self, run: Run) -> Run:
        """From where linear tets of compressible tissue end, if they find a sound answer."""
        linear = PreparedFenicsx(compressible(run.scene), "P1", "cg", alone=self.comm is ALONE)
        near = linear.solve(tolerance=LOAD_STEP_TOLERANCE)
        run.record.add(near.iterations, **near.detail)
        sound = near.converged and not anywhere(self.comm, near.volume_ratio <= 0.0)
        return run.from_start(near.positions) if sound else run.from_start(run.scene.vertices)

    def _nodal(self, end: Attempt) -> Nodal:
        """An answer by node."""
        ends, values = end.numbering.all_nodes(end.u)
        force = None if self._force is None else self._numbering.all_nodes(self._force)
        return Nodal(ends, values, force, self._by_vertex(end.pressure))

    def _by_vertex(self, pressure: Floats | None) -> Floats | None:
        """A pressure, a field, by scene vertex, of all processes."""
        if pressure is None:
            return None
        problem, asked = self._problem, self._numbering.asked
        mine = problem.pressures.owned if self._numbering.divided else len(pressure)
        result = np.zeros(len(self.scene.vertices))
        result[gathered(asked, problem.pressure_vertex[:mine])] = gathered(asked, pressure[:mine])
        return result

    def set_body_force(self, density: Callable[[Floats], Floats]):
        """Load every later solve by a force per rest volume [mN/mm³]: (q, 3) at places (q, 3) [mm], for studies."""
        self.set_forces(density(self.force_points()))

    def force_points(self) -> Floats:
        """The places (q, 3) [mm] in all tets at which a force per volume is taken."""
        return gathered(self.comm, Sampling(self._numbering, FORCE_DEGREE).X)

    def set_forces(self, density: Floats):
        """Load every later solve by a force per rest volume [mN/mm³], shape (q, 3), at `force_points`."""
        sampling = Sampling(self._numbering, FORCE_DEGREE)
        counts = self.comm.allgather(len(sampling.X))
        begin = sum(counts[: self.comm.rank])
        self._force = sampling.load(density[begin : begin + len(sampling.X)])

    def fields(self, degree: int) -> Fields:
        """The last solve's finite-element functions at the points of a quadrature rule; SceneError before a solve."""
        if self._end is None:
            raise SceneError("fields: nothing is solved yet")
        pressure = self._end.pressure
        at_cells = None if pressure is None else pressure[self._problem.pressure_dofs]
        return Sampling(self._end.numbering, degree).fields(self._end.u, at_cells)


class MirroredFenicsx:
    """A PreparedFenicsx of all processes, as the one has it that runs a command: see `ranks`."""

    def __init__(self, everywhere: Mirrored, scene: Scene):
        self._everywhere, self.scene = everywhere, scene

    @check_arguments
    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        warm: Solution | None = None,
        remember: bool = False,
        on_iteration: OnIteration | None = None,
        **limits: Any,
    ) -> Solution:
        """See PreparedFenicsx; what a solution remembers is not sent to other processes, its positions are."""
        begin = warm.positions if start is None and warm is not None else start
        return self._everywhere.call("solve", scene, here={"on_iteration": on_iteration}, start=begin, **limits)

    def march(self, **course: Any) -> Trajectory:
        """See PreparedFenicsx."""
        return march(self.scene, prepared=self, **course)

    def carry_out(self, motion: Motion) -> Trajectory:
        """See PreparedFenicsx."""
        return self._everywhere.call("carry_out", bare(motion), here={"own": motion})

    def set_body_force(self, density: Callable[[Floats], Floats]):
        """See PreparedFenicsx."""
        self._everywhere.call("set_forces", density(self._everywhere.call("force_points")))

    def fields(self, degree: int) -> Fields:
        """See PreparedFenicsx."""
        return self._everywhere.call("fields", degree)


def carry_out(motion: Motion, *, element: str = "P1") -> Trajectory:
    """See `softdeca.reference.march`."""
    check(motion, element)
    return prepare(motion.scene, element=element).carry_out(motion)


def compressible(scene: Scene) -> Scene:
    """The scene with a neo-Hookean law of the same shear modulus and a low bulk modulus in place of every law."""

    def softer(term: Term) -> Term:
        if not isinstance(term, Hyperelastic):
            return term
        mu = term.material.shear_modulus
        return replace(term, material=NeoHookean(mu, BULK * mu))

    return replace(scene, terms=tuple(softer(term) for term in scene.terms))
