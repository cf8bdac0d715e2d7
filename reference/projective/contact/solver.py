"""Contact as a solve that follows the one without (SoftDECA 3.3.2): look for it, push apart, look again.

Where surfaces overlap deeply, the way there from rest is gone again first, with contact met on the way: then nothing
has gone through, out at the back. On that way the energy is replaced by its PD matrix A around the solution without
contact, so that contact alone is solved for: with û the displacement without contact at a share of the way and g its
gaps, the forces f >= 0 minimise the dual ½ fᵀ (C A⁻¹ Cᵀ + 1/stiffness) f + gᵀ f, and the displacement is û + A⁻¹ Cᵀ f.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...solution import Reason
from ...terms import Contact
from ..descent import Point, Problem, Watch, lbfgs
from ..policy import POLICY, ContactPolicy
from ..unknowns.coordinates import Place
from ..unknowns.system import System
from .constraints import Constraints, Elasticity
from .detection import ContactSurface, Detection, detect


@dataclass(frozen=True)
class LooseWatch:
    """Shows a watch each point, and stops at a threshold [mN] of its own that is above the watch's."""

    watch: Watch
    threshold: float

    def see(self, point: Point) -> Reason | None:
        """Take note of a point."""
        reason = self.watch.see(point)
        return Reason.CONVERGED if reason is None and point.norm <= self.threshold else reason


@dataclass(frozen=True, eq=False)
class ContactSolver:
    """The surfaces of a scene's Contact terms, and the entries of A⁻¹ between their vertices needed so far."""

    surfaces: tuple[ContactSurface, ...]
    vertices: Ints
    elasticity: Elasticity
    policy: ContactPolicy = ContactPolicy()

    @classmethod
    def from_scene(cls, scene: Scene, system: System, policy: ContactPolicy = POLICY.contact) -> ContactSolver:
        """Raise SceneError for triangles that are not the tets' surface."""
        surfaces = tuple(ContactSurface.from_term(scene, term, policy) for term in scene.of(Contact))
        vertices = np.unique(np.concatenate([surface.ids for surface in surfaces]))
        return cls(surfaces, vertices, Elasticity(system, vertices), policy)

    def detect(self, x: Floats, earlier: Constraints | None = None) -> Detection:
        """Detect all surfaces' contact with themselves at x [mm], shape (n, 3); `earlier` as in `detection`."""
        return Detection.merge([detect(surface, x, earlier) for surface in self.surfaces])

    def solve(
        self, problem: Problem, point: Point, rest: Floats, watch: Watch
    ) -> tuple[Point, Reason, dict[str, float]]:
        """Continue from the solution without contact; the point, why it stopped, and counts for `Solution.detail`.

        Each round freezes the gaps where contact is, descends on energy and contact together, and takes the forces
        there for multipliers of the next round's gaps (the method of multipliers, with the geometry brought up to
        date), until nothing is deeper than `policy.parted`; the last descent goes on to the watch's own threshold.
        Where the depth does not fall any more, the least deep point is returned with Reason.CONTACT. The counts are
        crossing pairs of triangles and greatest depths [mm] before and after, and rounds.
        """
        policy = self.policy
        before = contact = self.detect(rest + point.u)
        reason, rounds, place = Reason.CONVERGED, 0, point.place
        is_tight = contact.depth <= policy.parted
        if contact.depth > policy.step:
            place, contact = approach(self.elasticity, self.detect, rest, place, self.vertices, policy)
        constraints, best, since = contact.constraints, (point, before), 0
        while not (is_tight and contact.depth <= policy.allowed_depth):
            if since == policy.patience:
                point, contact, reason = *best, Reason.CONTACT
                break
            is_tight = contact.depth <= policy.parted
            touching = self._with(problem, constraints, rest, place)
            first = touching.at(place)
            watch.forget()
            point, reason = lbfgs(touching, first, watch if is_tight else LooseWatch(watch, policy.loose * first.norm))
            if reason is Reason.STAGNATED and watch.best is not None:
                point = watch.best
            place, x, rounds = point.place, rest + point.u, rounds + 1
            constraints = replace(constraints, multipliers=constraints.forces(x))
            contact = self.detect(x, constraints)
            if reason not in (Reason.CONVERGED, Reason.STAGNATED):
                break
            constraints = contact.constraints.carry_multipliers(constraints)
            since += 1
            if contact.depth < 0.9 * best[1].depth:
                best, since = (point, contact), 0
        return point, reason, {
            "contact_pairs_before": float(before.pairs),
            "contact_pairs_after": float(contact.pairs),
            "contact_depth_before": before.depth,
            "contact_depth_after": contact.depth,
            "contact_rounds": float(rounds),
        }  # fmt: skip

    def _with(self, problem: Problem, constraints: Constraints, rest: Floats, place: Place) -> Problem:
        """The problem with contact in its energy, and in its matrix where it pushes."""
        matrix = self.elasticity.with_constraints(constraints, place)

        def at(ahead: Place) -> Point:
            point = problem.at(ahead)
            gradient = np.zeros_like(rest)
            energy = constraints.add_to(rest + ahead.u, gradient)
            pulled = self.elasticity.system.coordinates.pull(gradient, ahead)
            return Point(ahead, point.energy + energy, point.gradient + pulled)

        def precondition(vector: Floats, near: Point) -> Floats:
            return matrix.solve(vector, constraints.forces(rest + near.u) > 0.0, near.place.rotations)

        return Problem(at, problem.move, precondition, policy=problem.policy)


def approach(
    elasticity: Elasticity,
    detect: Callable[[Floats, Constraints | None], Detection],
    rest: Floats,
    end: Place,
    vertices: Ints,
    policy: ContactPolicy = POLICY.contact,
) -> tuple[Place, Detection]:
    """Find a place like `end` that is not overlapped as deeply, and the contact there, with its forces for multipliers.

    rest [mm], shape (n, 3); vertices (k,) are those of the surfaces.
    """
    moved = end.u[vertices]
    steps = max(1, int(np.ceil(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max() / policy.step)))
    coordinates = elasticity.system.coordinates
    place = force_free = coordinates.start(0.0 * end.u)
    contact = detect(rest + place.u, None)
    for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
        ahead = coordinates.start(share * end.u)
        # Where contact pushed so far is a better place to look than where nothing did.
        place = coordinates.start(place.u + ahead.u - force_free.u)
        force_free = ahead
        for _ in range(policy.looks):
            contact = detect(rest + place.u, contact.constraints)
            place, contact = _push(elasticity, rest, force_free, contact, policy.sweeps)
            if contact.depth <= policy.nearly:
                break
    return place, contact


def _push(
    elasticity: Elasticity, rest: Floats, force_free: Place, contact: Detection, sweeps: int
) -> tuple[Place, Detection]:
    """Move away from a place without contact forces by those that minimise the dual."""
    constraints = contact.constraints
    if not len(constraints.ids):
        return force_free, contact
    gradients, compliance = elasticity.compliance(constraints, force_free)
    forces = constraints.multipliers.copy()
    gaps = constraints.gaps(rest + force_free.u)
    _minimise_dual(compliance + np.diag(1.0 / constraints.stiffness), gaps, forces, sweeps)
    step = elasticity.system.solve(gradients.T @ forces, force_free.rotations)
    place = elasticity.system.coordinates.move(force_free, step)
    return place, replace(contact, constraints=replace(constraints, multipliers=forces))


@njit(cache=True)
def _minimise_dual(matrix, gaps, forces, sweeps):
    """Projected Gauss-Seidel on the dual, from `forces` on, in place."""
    for _ in range(sweeps):
        change = 0.0
        for i in range(len(gaps)):
            slope = gaps[i]
            for j in range(len(gaps)):
                slope += matrix[i, j] * forces[j]
            force = max(forces[i] - slope / matrix[i, i], 0.0)
            change = max(change, abs(force - forces[i]) * matrix[i, i])
            forces[i] = force
        if change < 1e-4:
            break
