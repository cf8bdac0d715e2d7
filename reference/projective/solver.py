"""prepare and solve for projective dynamics: statics of the PD energies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from ...lhm.base.errors import SceneError, quote
from ...lhm.base.geometry.cholesky import LinearSolver
from ...lhm.base.mesh import Floats, Ints
from ..clock import Clock, Seconds
from ..scene import Scene, refuse_unknown
from ..solution import Limits, OnIteration, Reason, Recorder, Solution, first_positions, volume_ratio
from ..terms import Contact, Fixed, RigidBody, Term
from .descent import Descent, Objective, Point, Watch, after_untangling, anderson, lbfgs, plain
from .hessian.newton_step import newton_step
from .hessian.tangent import Tangent
from .policy import POLICY, ProjectivePolicy
from .terms.energy import ENERGIES, Energy, recover
from .terms.gaps import Pairs
from .unknowns.coordinates import Coordinates, Place
from .unknowns.system import System

if TYPE_CHECKING:
    from .contact import ContactDescent

Method = Literal["lbfgs", "anderson", "plain"]
METHODS: dict[str, Descent] = {
    "lbfgs": partial(after_untangling, lbfgs, untangle=lbfgs),
    "anderson": partial(after_untangling, anderson, untangle=lbfgs),
    "plain": plain,
}
TERMS: tuple[type[Term], ...] = (*ENERGIES, Fixed, RigidBody, Contact)
"""Those with an energy, those that restrict `Coordinates`, and contact, which has a descent of its own."""
PREPARED = ((RigidBody, "rest"),)
"""Fields that may vary for other solvers, but are part of this one's matrix."""


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

    def solve(self, vector: Floats, rotations: Floats) -> Floats:
        self.global_solves += 1
        return self.system.solve(vector, rotations)

    def precondition(self, vector: Floats, point: Point) -> Floats:
        return self.solve(vector, point.place.rotations)

    def by(self, metric: Tangent) -> Callable[[Floats, Point], Floats]:
        def precondition(vector: Floats, point: Point) -> Floats:
            self.global_solves += 1
            return metric.solve(vector)

        return precondition

    def counts(self) -> dict[str, float]:
        return {
            "factorisations": float(len(self.system.groups)),
            "evaluations": float(self.evaluations),
            "global_solves": float(self.global_solves),
        }


@dataclass(frozen=True, eq=False)
class ProjectivePrepared:
    """A scene with its PD matrix factored; see `reference.solve.Prepared`."""

    scene: Scene
    method: Method
    energy: Energy
    system: System
    contact: ContactDescent | None
    spent: Seconds
    policy: ProjectivePolicy = POLICY

    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = 1e-6,
        absolute: float | None = None,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
        untangle: bool = True,
        metric: Tangent | None = None,
    ) -> Solution:
        """Minimise the energy of the prepared scene, or of one that differs only in what terms say is `varying`.

        start [mm], shape (n, 3), default rest. What is Fixed is put where it is held, and a RigidBody where it fits
        best, before the first iteration. A start with inverted tets is untangled first, unless it is known to need
        none: not to `untangle` one near the answer saves half the iterations, and method "plain" never does.
        `absolute` [mN] is the gradient norm to stop at, in place of one relative to the start's: what asks the same of
        every frame, wherever it starts. `metric`, from `tangent`, is the Hessian at an answer near by, in place of the
        PD matrix: from there to here far fewer iterations are left, each of about twice the price.
        Nothing is factored again. `detail` counts factorisations, evaluations and global solves; with Contact in the
        scene, whose descent is L-BFGS by whatever method, see `contact.descent.ContactDescent.summarise`.
        Raises SceneError if `scene` needs a new preparation, if start, tolerance or `absolute` are out of range, if the
        metric is of other unknowns, or if loads push a part that nothing holds.
        """
        recorder, policy = Recorder(on_iteration), self.policy
        scene = self.scene if scene is None else scene
        self.scene.check_prepared_for(scene, fixed=PREPARED)
        limits = Limits(tolerance, absolute, max_iterations)
        held, values = scene.dirichlet()
        coordinates = self.system.coordinates
        begin = first_positions(scene, start)
        place = coordinates.start(np.where(held, values, begin) - scene.vertices)
        energy = self.energy.for_scene(scene)
        self.system.check_loads(energy.loads)
        if metric is not None and metric.coordinates.size != coordinates.size:
            raise SceneError(f"metric: it has {metric.coordinates.size} unknowns, the scene {coordinates.size}")
        work = _Work(self.system)
        precondition = work.precondition if metric is None else work.by(metric)
        bounded = energy.is_bounded and metric is None
        problem = Objective(work.on(energy), coordinates.move, precondition, bounded=bounded, policy=policy.descent)
        if untangle and (volume_ratio(self.scene, scene.vertices + place.u) <= 0).any():
            relaxed = work.on(energy.untangling(policy.volume_share_of(self.method)))
            untangling = Objective(relaxed, coordinates.move, work.precondition, policy=policy.descent)
            problem = replace(problem, untangling=untangling)
        first, met = problem.at(place), None
        is_moved = led = False
        most = policy.max_iterations if limits.iterations is None else int(limits.iterations)
        start_norm, rounding = first.norm, scene.rounding()
        threshold = limits.threshold(scene, start_norm)
        watch = Watch(recorder, scene.vertices, threshold, most, policy.descent, rounding=rounding)
        descend = METHODS[self.method]
        if self.contact is not None:
            apart = partial(self.contact.descend, solve=work.solve)
            descend = partial(after_untangling, apart, untangle=apart)
            is_moved = bool((values != begin)[held].any())
            led = is_moved and self.contact.is_met(begin, scene.vertices + place.u)
            if led:
                problem = replace(problem, untangling=None)
                first, met, forces = self.contact.lead(problem, begin, place.u, watch, solve=work.solve)
                watch.threshold = limits.threshold(scene, max(start_norm, forces))
        point, reason = (first, met) if met is not None else descend(problem, first, watch)
        if reason is Reason.STAGNATED and watch.best is not None:
            point = watch.best
        positions = np.where(held, values, scene.vertices + point.u)
        contact: dict[str, float] = {}
        if self.contact is not None:
            contact = self.contact.summarise(positions)
            if reason in (Reason.CONVERGED, Reason.STAGNATED):
                crosses = contact["contact_crossings"] > self.contact.crossings_at_rest
                # The descent sees the way of what is free, `lead` that of what is held.
                if crosses or (is_moved and not led and self.contact.leaps(begin, positions)):
                    reason = Reason.CONTACT
        return Solution(
            positions=positions,
            reason=reason.at_rounding(scene, point.norm),
            iterations=watch.iteration,
            energy=point.energy,
            history=recorder.history(),
            volume_ratio=volume_ratio(self.scene, positions),
            detail=work.counts() | contact,
            recovery=partial(recover, scene, positions, self.contact.find_pushes if self.contact else None),
            times=recorder.times(self.spent),
        )

    def freeze_contact(self, positions: Floats, scene: Scene | None = None, *, pressed: bool = False) -> Scene:
        """Return a scene whose Contact is that of the pairs near at positions [mm], shape (n, 3), as Gaps.

        There it has the same energy, and as long as no other pair comes near: for solvers that look for none. With
        `pressed` the pairs are only those that push. A scene without Contact is left as it is; scene as of `solve`.
        """
        scene = self.scene if scene is None else scene
        if self.contact is None:
            return scene
        gaps = self.contact.freeze(positions, pressed=pressed)
        others = (term for term in scene.terms if not isinstance(term, Contact))
        return replace(scene, terms=(*others, *([gaps] if len(gaps.pairs) else [])))

    def tangent(
        self,
        solution: Solution,
        scene: Scene | None = None,
        *,
        linear_solver: LinearSolver | None = None,
    ) -> Tangent:
        """Factor the exact Hessian at a scene's solution: for derivatives, and as a metric of scenes near by.

        Where it is not positive definite, which no minimum without a flat direction is, each element's
        eigenvalues are raised to 0, and `Tangent.is_exact` is False. scene as of `solve`; linear_solver None is CHOLMOD
        where the system has it (see `factorise_definite`). What does not depend on the numbers serves again for another
        scene of the same topology, such as of another identity. Contact is that of the pairs near at the solution.
        """
        scene = self.scene if scene is None else scene
        self.scene.check_prepared_for(scene, fixed=PREPARED)
        held, values = scene.dirichlet()
        positions = np.where(held, values, solution.positions)
        energy, coordinates = self.energy.for_scene(scene), self.system.coordinates
        if self.contact is not None:
            scene = self.freeze_contact(positions, scene, pressed=True)
            pairs = Pairs.from_scene(scene)
            others = tuple(part for part in energy.parts if not isinstance(part, Pairs))
            energy = Energy(others if pairs is None else (*others, pairs))  # which has the scene's own Gaps, too
        place = coordinates.start(positions - scene.vertices)
        return Tangent.from_scene(scene, energy, coordinates, place, linear_solver=linear_solver)

    def touches(self, positions: Floats) -> bool:
        """Tell whether surfaces in Contact are too near at positions [mm], shape (n, 3), or cross."""
        return self.contact is not None and self.contact.touches(positions)

    def estimate_left(
        self, positions: Floats, tangent: Tangent, vertices: Ints | slice, scene: Scene | None = None
    ) -> tuple[Floats, bool]:
        """Estimate how far vertices still are from a scene's minimum [mm], shape (n, 3), by a tangent of near by.

        vertices: those that count; scene as of `solve`. Also returns whether the estimate is good (`newton_step`).
        Where surfaces touch, their pushes are held as they are: the pairs' stiffness, left out, would shorten the way,
        and what it turns is covered by a factor, `NewtonStepPolicy.pushed`. SceneError for a tangent of other unknowns.
        """
        scene = self.scene if scene is None else scene
        coordinates, work, energy = self.system.coordinates, _Work(self.system), self.energy.for_scene(scene)
        if tangent.coordinates.size != coordinates.size:
            raise SceneError(f"tangent: it has {tangent.coordinates.size} unknowns, the scene {coordinates.size}")
        pushes = np.zeros_like(positions) if self.contact is None else self.contact.find_pushes(positions)

        def at(place: Place) -> Point:
            value, gradient = energy.evaluate(place.u)
            return Point(place, value - float(np.sum(pushes * place.u)), coordinates.pull(gradient - pushes, place))

        objective = Objective(at, coordinates.move, work.by(tangent), bounded=False)
        point = objective.at(coordinates.start(positions - scene.vertices))
        ahead = newton_step(objective, point, vertices, self.policy.newton_step)
        left = coordinates.move(point.place, ahead.step).u - point.u
        return (self.policy.newton_step.pushed * left if pushes.any() else left), ahead.is_near


def prepare(scene: Scene, *, method: Method = "lbfgs", policy: ProjectivePolicy = POLICY) -> ProjectivePrepared:
    """Factor the PD matrix of a scene.

    method is "lbfgs", "anderson" (both accelerated) or "plain" (local/global); `policy` has the constants. Raises
    SceneError for a term that is none of TERMS, and for another method.
    """
    if method not in get_args(Method):
        raise SceneError(f"projective: unknown method {method!r}; there are {', '.join(get_args(Method))}")
    refuse_unknown(scene, "projective", TERMS, prisms=True)
    if not isinstance(policy, ProjectivePolicy):
        raise SceneError(f"projective: policy: expected a ProjectivePolicy, got {quote(policy)}")
    clock = Clock()
    energy = Energy.from_scene(scene)
    matrix, anchored = energy.matrix(scene, volume_share=policy.volume_share_of(method))
    system = System.from_matrix(matrix, anchored, Coordinates.from_scene(scene))
    contact = None
    if scene.of(Contact):
        from .contact import ContactDescent  # costs an import of its own, which few scenes need

        contact = ContactDescent.from_scene(scene, system, policy.contact)
    return ProjectivePrepared(scene, method, energy, system, contact, clock.read(), policy)
