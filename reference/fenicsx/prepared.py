"""prepare and solve on FEniCSx: mesh, forms and matrix once, strategies in turn per call.

There are three strategies. "minimise" is Newton's method on the energy: it gets from anywhere to some minimum.
"augmented Lagrangian" does so for elements with a pressure, which it corrects between minimisations. "load steps"
solves the equations of equilibrium where forces have no energy: under follower pressure.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from .. import materials
from ..clock import Clock
from ..materials import NeoHookean
from ..restraint import check_restrained
from ..scene import Scene, refuse_unknown
from ..solution import Limits, OnIteration, Solution, first_positions
from ..terms import Fixed, Gravity, Hyperelastic, Pressure, RigidBody, Term, Traction
from .dolfinx_version import ALONE
from .energy.solids import check_solids
from .fields import Fields, NodalAnswer, Sampling, recover
from .linear.problem import MODELS, DiscreteProblem
from .linear.saddle import SaddleMatrix
from .linear.saddle_block import SADDLES
from .linear.solvers import LINEAR_SOLVERS, ConjugateGradients, LinearSolver, Mumps
from .mesh.numbering import DEGREE_OF, Numbering, ranks_for
from .mesh.parallel import anywhere, check_same
from .policy import POLICY, FenicsxPolicy
from .run import Attempt, Record, Run
from .strategies.bodies import RigidProblem
from .strategies.load_steps import LoadSteps
from .strategies.minimise import Minimisation
from .strategies.multipliers import Condensed, MultiplierDescent

TERMS: tuple[type[Term], ...] = (*MODELS, Gravity, Traction, Fixed, RigidBody)
"""Those with an energy or a force that follows, dead loads, and those that restrict the unknowns."""
FORCE_DEGREE = 6


def prepare(
    scene: Scene, *, element: str = "P1", linear_solver: str = "cg", policy: FenicsxPolicy = POLICY
) -> PreparedFenicsx:
    """Make mesh, forms (compiled once per kind of scene, then cached on disk) and the matrix' pattern.

    element is "P1", "P2", or "P2P1" of quadratic displacement and linear pressure, for (nearly) incompressible laws.
    linear_solver is "cg" (conjugate gradients with algebraic multigrid, for large scenes) or "mumps" (direct).
    "cg" is direct too for nearly incompressible laws (see `policy.stiff`) below `policy.large_stiff` unknowns. With
    "P2P1", "cg" means a direct solver below `policy.saddle.large` unknowns and GMRES with a block preconditioner above;
    "block" asks for the latter at any size. Scenes with Pressure always take factors. `policy` has all other constants.

    Raises SceneError for another element or linear solver, and for a term or law that this solver or element cannot
    model.
    """
    if element not in DEGREE_OF:
        raise SceneError(f"solver 'fenicsx': unknown element {element!r}; there are {', '.join(DEGREE_OF)}")
    _check_terms(scene, element)
    names = SADDLES if element == "P2P1" else tuple(LINEAR_SOLVERS)
    if linear_solver not in names:
        raise SceneError(f"solver 'fenicsx': unknown linear_solver {linear_solver!r}; there are {', '.join(names)}")
    if linear_solver == "block" and scene.of(Pressure):
        raise SceneError("solver 'fenicsx': linear_solver 'block' has no use for Pressure, which takes factors")
    return PreparedFenicsx(scene, element, linear_solver, policy)


def _check_terms(scene: Scene, element: str):
    if not len(scene.tets):
        raise SceneError("solver 'fenicsx': the scene has no tets")
    refuse_unknown(scene, "fenicsx", TERMS, materials.LAWS, prisms=element == "P1")
    check_solids(scene, element)
    if scene.of(RigidBody) and (element == "P2P1" or scene.of(Pressure)):
        raise SceneError("solver 'fenicsx' cannot model RigidBody with element 'P2P1' or Pressure; fix its vertices")


class InUse:
    """Lets one thread at a time in; SceneError for a thread that is in already."""

    def __init__(self):
        self._lock, self._owner = threading.Lock(), 0

    def __enter__(self):
        if self._owner == threading.get_ident():
            raise SceneError("this prepared scene is being solved; prepare another for a solve within its callback")
        self._lock.acquire()
        self._owner = threading.get_ident()

    def __exit__(self, *_):
        self._owner = 0
        self._lock.release()


class PreparedFenicsx:
    """See `softdeca.reference.Prepared`; `detail` of a solution counts linear iterations and solves, and assemblies."""

    def __init__(
        self,
        scene: Scene,
        element: str,
        linear_solver: str,
        policy: FenicsxPolicy = POLICY,
        *,
        alone: bool = False,
    ):
        clock = Clock()
        self._policy, linear = policy, policy.linear
        self.scene, self._element, self._linear_solver = scene, element, linear_solver
        self.comm = ALONE if alone else ranks_for(scene)
        check_same(self.comm, scene)
        self._numbering = Numbering(scene, DEGREE_OF[element], comm=self.comm)
        self._large = self.comm.allreduce(len(self._numbering.tet)) >= policy.large
        self._problem = DiscreteProblem(scene, self._numbering, mixed=element == "P2P1")
        # Multigrid leaves too much of volumes in steps by a displacement alone.
        stiff = any(t.material.stiffness > policy.stiff * t.material.shear_modulus for t in scene.of(Hyperelastic))
        small = 3 * self._numbering.nodes.total < policy.large_stiff
        by_factors = linear_solver == "mumps" or (linear_solver == "cg" and stiff and small)
        make = LINEAR_SOLVERS["mumps" if by_factors else "cg"]
        problem = self._problem
        self._direct = Mumps(problem.matrix, policy=linear)
        self._linear: LinearSolver = self._direct
        if not by_factors:
            self._linear = ConjugateGradients(problem.matrix, problem.levels, policy=linear)
        self._rigid: tuple[RigidProblem, LinearSolver, LinearSolver] | None = None
        if scene.of(RigidBody):
            rigid = RigidProblem(scene, self._numbering, self._problem)
            self._rigid = rigid, make(rigid.matrix, policy=linear), Mumps(rigid.matrix, policy=linear)
        self._saddle = SaddleMatrix(self._problem, policy.saddle) if element == "P2P1" else None
        self._condensed: Condensed | None = None
        if self._saddle is not None and not scene.of(Pressure):
            self._condensed = Condensed(self._problem, self._saddle, policy=policy)
        self._force: Floats | None = None
        self._end: Attempt | None = None
        self._in_use = InUse()
        self._spent = clock.read()

    def __reduce__(self):
        raise SceneError(
            "a scene prepared by solver 'fenicsx' cannot be copied or pickled; prepare it where it is solved"
        )

    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = 1e-6,
        absolute: float | None = None,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Solution:
        """Solve the prepared scene, or one that differs only in what terms say is `varying`.

        The first gradient norm, to which tolerance relates, includes the forces that the held vertices' motion causes.
        See `softdeca.reference.Prepared.solve`.
        """
        with self._in_use:
            return self._solve_scene(scene, start, tolerance, absolute, max_iterations, on_iteration)

    def _solve_scene(self, scene, start, tolerance, absolute, max_iterations, on_iteration) -> Solution:
        """Solve; vectors and matrices are those of all solves, so one at a time."""
        scene = self.scene if scene is None else scene
        check_same(self.comm, scene)
        self.scene.check_prepared_for(scene)
        limits, record = Limits(tolerance, absolute, max_iterations), Record(max_iterations, on_iteration)
        begin = first_positions(scene, start)
        run = Run(scene, self._numbering, begin, limits, record, is_given=start is not None)
        self._problem.set(scene)
        if self._force is not None:
            self._problem.loads = self._problem.loads + self._force
        without_energy = self._element == "P2P1" or bool(scene.of(Pressure))
        check_restrained(scene, loads=None if without_energy else scene.loads())
        self._end = end = self._solve(run)
        answer = NodalAnswer.collect(self._problem, end, self._force)
        recovery = partial(recover, scene, self._numbering.degree, answer)
        return run.solution(end, self._spent, recovery)

    def _solve(self, run: Run) -> Attempt:
        """Solve by the strategy that the scene and the element take."""
        problem, policy, assembled = self._problem, self._policy, self._problem.assemblies
        if run.scene.of(Pressure):
            end = LoadSteps(run, problem, saddle=self._saddle, policy=policy).attempt()
        elif self._condensed is None:
            end = Minimisation(run, problem, self._linear, self._direct, self._rigid, policy).attempt()
        else:
            find_start = self._start_from_linear if self._large and not run.is_given else None
            kind = self._linear_solver
            end = MultiplierDescent(
                run, self._condensed, linear_solver=kind, find_start=find_start, policy=policy
            ).attempt()
        run.record.add(0, assemblies=problem.assemblies - assembled)
        return end

    def _start_from_linear(self, run: Run) -> Run:
        """The run from where linear tets of compressible tissue end, if they find a sound answer."""
        policy, softer = self._policy, as_compressible(run.scene, self._policy.start_bulk)
        linear_tets = PreparedFenicsx(softer, "P1", "cg", policy, alone=self.comm is ALONE)
        near = linear_tets.solve(tolerance=policy.minimise.load_step_tolerance)
        run.record.add(near.iterations, **near.detail)
        sound = near.converged and not anywhere(self.comm, near.volume_ratio <= 0.0)
        return run.restart(near.positions if sound else run.scene.vertices)

    def set_body_force(self, density: Callable[[Floats], Floats]):
        """Load every later solve by a force per rest volume [mN/mm³]: (q, 3) at places (q, 3) [mm], for studies."""
        sampling = Sampling(self._numbering, FORCE_DEGREE)
        self._force = sampling.load(density(sampling.X))

    def fields(self, degree: int) -> Fields:
        """Give the last solve's finite-element functions at the points of a rule; SceneError before a solve."""
        if self._end is None:
            raise SceneError("fields: nothing is solved yet")
        pressure = self._end.pressure
        at_cells = None if pressure is None else pressure[self._problem.pressure_dofs]
        return Sampling(self._end.numbering, degree).fields(self._end.u, at_cells)


def as_compressible(scene: Scene, bulk: float = POLICY.start_bulk) -> Scene:
    """Give every law's place to a neo-Hookean one of the same shear modulus and lmbda = `bulk` mu."""
    terms: list[Term] = []
    for term in scene.terms:
        if isinstance(term, Hyperelastic):
            mu = term.material.shear_modulus
            term = replace(term, material=NeoHookean(mu, bulk * mu))
        terms.append(term)
    return replace(scene, terms=tuple(terms))
