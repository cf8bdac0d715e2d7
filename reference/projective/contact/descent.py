"""The way down that surfaces do not cross: L-BFGS models elasticity, and contact is solved for in its model.

Each iteration measures what is near, and finds the forces λ >= 0 of those rows for which the step of the model,
d = -B⁻¹ (g - Pᵀ Cᵀ λ), leaves them as deep as `Rows.give_way` says: a gap that the step would close is a row
already, so the step goes round it. Continuous collision detection bounds the step, and energy with contact has to fall.
L-BFGS learns from elasticity's gradient g alone, for contact is never modelled but as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ....lhm.base.mesh import Floats
from ...scene import Scene
from ...solution import Reason
from ...terms import Gaps
from ..descent import Objective, Observer, Point, lbfgs
from ..policy import POLICY, ContactPolicy
from ..unknowns.coordinates import Place
from ..unknowns.system import System
from .model import Compliance, Model
from .points import ContactPoints
from .rows import Rows
from .surfaces import ContactSurface, Nearby

SolveMatrix = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, eq=False)
class Touching:
    """A point without contact's energy, the contact points there (k, 3) [mm], and what is near on them."""

    free: Point
    x: Floats
    rows: Rows
    total: Point


@dataclass(frozen=True, eq=False)
class ContactDescent:
    """A descent of a scene's energy with its Contact terms: their points, their surfaces, and A⁻¹ between points."""

    rest: Floats
    points: ContactPoints
    surfaces: Sequence[ContactSurface]
    compliance: Compliance
    system: System
    policy: ContactPolicy = POLICY.contact

    @classmethod
    def from_scene(cls, scene: Scene, system: System, policy: ContactPolicy = POLICY.contact) -> ContactDescent:
        """Make the surfaces of a scene; nothing is solved for yet."""
        points = ContactPoints.from_scene(scene)
        surfaces = ContactSurface.from_scene(scene, points, policy)
        touching = np.unique(np.concatenate([surface.find_near(policy.touching).ravel() for surface in surfaces]))
        if touching.size:
            points = points.drawn_back(scene, touching[touching < len(points.vertices)], policy.offset)
            surfaces = ContactSurface.from_scene(scene, points, policy)
        return cls(scene.vertices, points, surfaces, Compliance(system, points.vertices), system, policy)

    def descend(self, problem: Objective, point: Point, watch: Observer, *, solve: SolveMatrix) -> tuple[Point, Reason]:
        """Minimise a problem's energy and contact's from a point; see `descent.Descent`. The watch sees both together.

        `solve` is A⁻¹ on a vector over the unknowns at the bodies' rotations.

        As long as nothing touches this is L-BFGS without contact, which costs no more. A start at which more crosses
        than at rest is left for rest. A point at which no step lowers the energy is STAGNATED.
        """
        nearby = Nearby(self.surfaces, self.policy)
        if self.count_crossings(self.find_places(point.place)) > self.crossings_at_rest:
            rest = np.where(self.system.coordinates.held, point.u, 0.0)
            point = problem.at(self.system.coordinates.start(rest))
        contact_watch = ContactWatch(self, nearby, watch)
        end, reason = lbfgs(problem, point, contact_watch)
        if not contact_watch.has_touched:
            return end, reason
        watch.forget()
        begin = point if contact_watch.free is None else contact_watch.free
        rotations, coordinates = begin.place.rotations, self.system.coordinates
        model = Model(lambda vector: solve(vector, rotations), coordinates, self.compliance, self.points, rotations)
        return self._descend_touching(problem, begin, watch, nearby, model)

    def _descend_touching(
        self, problem: Objective, point: Point, watch: Observer, nearby: Nearby, model: Model
    ) -> tuple[Point, Reason]:
        x = self.find_places(point.place)
        here = self._touch(point, x, nearby.find_rows(x))
        solved = model.solve_start(point.gradient)
        pushes = here.rows.spread(here.rows.forces, len(self.points))
        while (reason := watch.record(here.total)) is None:
            gradient = here.free.gradient
            model.turn(here.free.place.rotations)
            right, solved_right = -gradient, -solved
            if (turning := here.rows.turn(len(self.points))).any():
                spread = model.spread(turning)
                right, solved_right = right + spread, solved_right + model.solve_start(spread)
            free = model.restrict_solution(right, solved_right)
            wanted = self._find_pushes(model, here.rows, free, pushes)
            if wanted.any():
                spread = model.spread(wanted)
                right, solved_right = right + spread, solved_right + model.solve_start(spread)
            step = model.solve(right, solved_right)
            # The model gives slope and curvature of elasticity's energy along the step.
            taken = self._take(problem, nearby, here, step, (float(gradient @ step), float(right @ step)))
            if taken is None:
                if model.is_empty:
                    return here.total, Reason.STAGNATED
                model.clear()
                continue
            share, ahead = taken
            before, solved = solved, model.solve_start(ahead.free.gradient)
            model.add(share * step, ahead.free.gradient - gradient, solved - before)
            pushes = pushes + share * (wanted - pushes)
            here = ahead
        return here.total, reason

    def is_met(self, begin: Floats, end: Floats) -> bool:
        """Tell whether surfaces touch at positions end (n, 3) [mm], or on the straight way there; see `leaps`."""
        return self.touches(end) or self.leaps(begin, end)

    def lead(
        self, problem: Objective, begin: Floats, goal: Floats, watch: Observer, *, solve: SolveMatrix
    ) -> tuple[Point, Reason | None, float]:
        """Move what is held from positions (n, 3) [mm] to displacements `goal` (n, 3) [mm], stage by stage.

        Surfaces that it meets give way: a stage's step has the forces that part them at its end, and a few iterations
        follow. Begins at rest where more crosses at `begin`. Returns where this ends, the reason: CONTACT for what does
        not give way, None at the goal, and the largest gradient norm [mN] that a stage has caused.
        """
        held, nearby = self.system.coordinates.held, Nearby(self.surfaces, self.policy)
        if self.count_crossings(self.points.find_places(begin)) > self.crossings_at_rest:
            begin = self.rest
        place = self.system.coordinates.start(begin - self.rest)
        model = Model(
            lambda vector: solve(vector, place.rotations),
            self.system.coordinates,
            self.compliance,
            self.points,
            place.rotations,
        )
        point, largest = problem.at(place), 0.0
        while (left := np.where(held, goal - point.u, 0.0)).any():
            x, gradient = self.find_places(point.place), point.gradient
            part = left * min(1.0, self.policy.led / float(np.linalg.norm(left, axis=1).max()))
            carried = self.points.find_places(self.rest + point.u + part) - x
            model.turn(point.place.rotations)
            solved = model.solve_start(gradient)
            free = model.restrict_solution(-gradient, -solved) + carried
            wanted = self._find_pushes(model, nearby.find_rows(x), free, np.zeros_like(x))
            right = model.spread(wanted)
            step = model.solve(right - gradient, model.solve_start(right) - solved)
            ahead = self._move(problem, point.place, step, part)
            share = nearby.find_free_share(x, self.find_places(ahead) - x)
            if share < self.policy.apart:
                return point, Reason.CONTACT, largest
            if share < 1.0:
                share *= self.policy.before
                ahead = self._move(problem, point.place, share * step, share * part)
            watch.forget()
            few = Few(watch, self.policy.following)
            point, _ = self._descend_touching(problem, problem.at(ahead), few, nearby, model)
            largest = max(largest, few.first)
            if few.reason is not None:
                return point, few.reason, largest
        return point, None, largest

    def _move(self, problem: Objective, place: Place, step: Floats, part: Floats) -> Place:
        """Take a step over the unknowns, and a part (n, 3) [mm] of the way of what is held."""
        moved = problem.move(place, step)
        return Place(moved.u + part, moved.rotations)

    def leaps(self, begin: Floats, end: Floats) -> bool:
        """Tell whether surfaces pass through each other on the straight way between positions (n, 3) [mm].

        The way begins at rest where more crosses at its begin than there; nothing is told of what crosses at rest.
        """
        if self.crossings_at_rest:
            return False
        x, goal = self.points.find_places(begin), self.points.find_places(end)
        if self.count_crossings(x):
            x = self.points.find_places(self.rest)
        longest = float(np.linalg.norm(goal - x, axis=1).max(initial=0.0))
        stages = np.linspace(x, goal, 1 + int(np.ceil(longest / self.policy.stage)))
        nearby = Nearby(self.surfaces, replace(self.policy, kept=self.policy.apart))
        for ahead in stages[1:]:
            # Sliding vertices come to their end in many shares; those that meet something stay where they are.
            while (share := nearby.find_free_share(x, ahead - x)) < 1.0:
                if share < self.policy.apart:
                    return True
                x = x + share * (ahead - x)
            x = ahead
        return False

    def summarise(self, positions: Floats) -> dict[str, float]:
        """Summarise contact at positions (n, 3) [mm] for `Solution.detail`: forces, and what crosses.

        The force is half of what all vertices are pushed with [mN]; "contact_crossings" are pairs of triangles.
        """
        x = self.points.find_places(positions)
        rows = self._find_rows(x)
        return {
            "contact_pairs": float(np.count_nonzero(rows.depth > 0.0)),
            "contact_force": float(0.5 * np.linalg.norm(rows.push(len(x)), axis=1).sum()),
            "contact_crossings": float(self.count_crossings(x)),
        }

    @property
    def find_pushes(self) -> Callable[[Floats], Floats]:
        """Return a function of positions (n, 3) [mm]: the forces [mN] on vertices and obstacles' carriers, (n, 3).

        It can be pickled, unlike what solves with A.
        """
        return partial(_push, self.points, self.surfaces, self.policy)

    def touches(self, positions: Floats) -> bool:
        """Tell whether pairs are too near at positions (n, 3) [mm], or more triangles cross than at rest."""
        x = self.points.find_places(positions)
        rows = self._find_rows(x)
        return bool((rows.depth > 0.0).any()) or self.count_crossings(x) > self.crossings_at_rest

    @cached_property
    def crossings_at_rest(self) -> int:
        """Pairs of triangles that cross at rest, which nothing parts."""
        return self.count_crossings(self.points.find_places(self.rest))

    def count_crossings(self, x: Floats) -> int:
        """Count the pairs of triangles that cross with contact points at x (k, 3) [mm]."""
        return sum(surface.count_crossings(x) for surface in self.surfaces)

    def find_places(self, place: Place) -> Floats:
        """Return the contact points' positions [mm], shape (k, 3), at a place."""
        return self.points.find_places(self.rest + place.u)

    def freeze(self, positions: Floats, *, pressed: bool = False) -> Gaps:
        """Return the pairs that are near at positions (n, 3) [mm], or only those that push, with their energy."""
        rows = self._find_rows(self.points.find_places(positions))
        return self.points.freeze(rows.select(np.flatnonzero(rows.depth > 0.0)) if pressed else rows)

    def _find_rows(self, x: Floats) -> Rows:
        """Find the pairs that are near, with contact points at x (k, 3) [mm], asked once."""
        return Nearby(self.surfaces, self.policy).find_rows(x)

    def _touch(self, point: Point, x: Floats, rows: Rows) -> Touching:
        """Add contact to a point of the energy without it, with contact points at x (k, 3) and these rows near."""
        forces = self.points.spread(rows.push(len(x)), len(self.rest))
        gradient = point.gradient - self.system.coordinates.pull(forces, point.place)
        return Touching(point, x, rows, Point(point.place, point.energy + rows.energy, gradient))

    def _find_pushes(self, model: Model, rows: Rows, free: Floats, pushes: Floats) -> Floats:
        """Find the forces on the contact points (k, 3) [mN] that the model's step ends with.

        free (k, 3): its motion without any; pushes (k, 3): the forces of the step before, under which gaps that would
        close count. Newton's method and active sets, each pass a dense solve, on C S Cᵀ λ + give_way(λ) = the depth
        after the free motion.
        """
        under = free + model.push(pushes) if pushes.any() else free
        rows = rows.select(np.flatnonzero((rows.depth > 0.0) | (rows.depth > rows.widen(under))))
        compliance = model.between(rows)
        movable = np.flatnonzero(np.diag(compliance) > 0.0)  # the others are held on both sides
        count, rows, compliance = len(movable), rows.select(movable), compliance[np.ix_(movable, movable)]
        if not count:
            return np.zeros_like(free)
        depth = rows.depth - rows.widen(free)
        active = rows.depth > 0.0
        if not active.any():
            active = depth > 0.0
        forces = rows.forces.copy()
        for _ in range(self.policy.passes):
            chosen = np.flatnonzero(active)
            given, yielding = rows.give_way(forces)
            matrix = compliance[np.ix_(chosen, chosen)] + np.diag(yielding[chosen])
            right = (depth - given + yielding * forces)[chosen]
            before, forces = forces, np.zeros(count)
            if len(chosen):
                found = cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False)
                forces[chosen] = np.maximum(found, 0.0)
            closed = depth - compliance @ forces > self.policy.closed
            closed[chosen] = forces[chosen] > 0.0
            settled = np.abs(rows.give_way(forces)[0] - given - yielding * (forces - before))
            if np.array_equal(closed, active) and np.all(settled <= self.policy.settled * rows.offset):
                break
            active = closed
        return rows.spread(forces, len(free))

    def _take(
        self, problem: Objective, nearby: Nearby, here: Touching, step: Floats, model: tuple[float, float]
    ) -> tuple[float, Touching] | None:
        """Take the share of a step that meets nothing and lowers the energy; None where none is found soon.

        model: slope and curvature of elasticity's energy along the step; where contact's rises by more than that says
        that it falls, elasticity is not asked.
        """
        share, least, policy, (slope, curvature) = 1.0, -1.0, self.policy, model
        rounding = problem.policy.rounding * abs(here.total.energy)
        while share > least:
            place = problem.move(here.free.place, share * step)
            x = self.find_places(place)
            met = nearby.find_free_share(here.x, x - here.x)
            least = policy.least * met if least < 0.0 else least
            if met < 1.0:
                share *= policy.before * met
                continue
            rows = nearby.find_rows(x)
            fall = -(share * slope + 0.5 * share**2 * curvature)
            if rows.energy - here.rows.energy <= max(fall, 0.0) + rounding:
                ahead = self._touch(problem.at(place), x, rows)
                if ahead.total.energy <= here.total.energy + rounding:
                    return share, ahead
            share *= 0.5
        return None


def _push(
    points: ContactPoints, surfaces: Sequence[ContactSurface], policy: ContactPolicy, positions: Floats
) -> Floats:
    x = points.find_places(positions)
    return points.spread(Nearby(surfaces, policy).find_rows(x).push(len(x)), len(positions))


class Few:
    """Shows a watch a few iterations; `first` is the first gradient norm [mN].

    `reason` is why the watch wants to stop, unless the gradient is small enough.
    """

    def __init__(self, watch: Observer, count: int):
        self._watch, self._left, self.first = watch, count, 0.0
        self.reason: Reason | None = None

    def record(self, point: Point) -> Reason | None:
        """Take note of a point."""
        self._left -= 1
        self.first = self.first or point.norm
        reason = self._watch.record(point)
        if reason is not None and reason is not Reason.CONVERGED:
            self.reason = reason
        return reason or (Reason.MAX_ITERATIONS if self._left < 0 else None)

    def forget(self):
        self._watch.forget()


class ContactWatch:
    """Shows a watch a descent without contact, and ends it where the way has met something.

    It looks at first and last point, and in between after 1, 4, 16, ... iterations: along the straight way from the
    last place that was `free`, and for what is too near.
    """

    def __init__(self, contact: ContactDescent, nearby: Nearby, watch: Observer):
        self._contact, self._nearby, self._watch = contact, nearby, watch
        self._seen, self._next = 0, 1
        self.free: Point | None = None
        self.has_touched = False

    def record(self, point: Point) -> Reason | None:
        """Take note of a point; it is shown to the watch unless it touches."""
        reason = None
        if self._seen in (0, self._next):
            self._next = max(1, 4 * self._seen)
            self._look(point)
        if not self.has_touched:
            reason = self._watch.record(point)
            if reason is Reason.CONVERGED:
                self._look(point)
        self._seen += 1
        return Reason.CONTACT if self.has_touched else reason

    def forget(self):
        self._watch.forget()

    def _look(self, point: Point):
        x = self._contact.find_places(point.place)
        begin = x if self.free is None else self._contact.find_places(self.free.place)
        is_free = self._nearby.find_free_share(begin, x - begin) >= 1.0
        self.has_touched = not is_free or bool((self._nearby.find_rows(x).depth > 0.0).any())
        if not self.has_touched:
            self.free = point
