"""Contact as a solve that follows the one without (SoftDECA 3.3.2): look for it, push apart, look again.

The way from rest to a deep overlap, with contact met on the way: then nothing has gone through, out at the back.

The energy is replaced by its PD matrix A around the solution without contact, so that contact alone is solved for: with
û the displacement without contact at a share of the way and g its gaps, the forces f >= 0 minimise the dual
½ fᵀ (C A⁻¹ Cᵀ + 1/stiffness) f + gᵀ f, and the displacement is û + A⁻¹ Cᵀ f.
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
from ..coordinates import Place
from ..descent import Point, Problem, Watch, lbfgs
from ..system import System
from .constraints import Constraints, Elasticity
from .detection import ContactSurface, Detection, detect

PATIENCE = 10
"""Rounds without a lesser depth after which contact is given up."""
ALLOWED_DEPTH = 0.05
"""The depth [mm] up to which surfaces may overlap in the end."""
PARTED = 0.02
"""The depth [mm] below which a descent goes on to the end."""
LOOSE = 0.03
"""While surfaces are deeper than that a descent ends at this share of its first gradient norm."""

SOLVED = (Reason.CONVERGED, Reason.STAGNATED)
"""How a descent ends that has come as far as it can."""


@dataclass(frozen=True)
class Loosely:
    """Shows a watch each point, and stops at a threshold [mN] of its own that is above the watch's."""

    watch: Watch
    threshold: float

    def see(self, point: Point) -> Reason | None:
        """Take note of a point."""
        reason = self.watch.see(point)
        return Reason.CONVERGED if reason is None and point.norm <= self.threshold else reason


@dataclass(frozen=True, eq=False)
class ContactSolver:
    """The surfaces of a scene's Contact terms, and what of A⁻¹ between their vertices was asked for so far."""

    surfaces: tuple[ContactSurface, ...]
    vertices: Ints
    elasticity: Elasticity

    @classmethod
    def of(cls, scene: Scene, system: System) -> ContactSolver:
        """Raise SceneError for triangles that are not the tets' surface."""
        surfaces = tuple(ContactSurface.of(scene, term) for term in scene.of(Contact))
        vertices = np.unique(np.concatenate([surface.ids for surface in surfaces]))
        return cls(surfaces, vertices, Elasticity(system, vertices))

    def detect(self, x: Floats, earlier: Constraints | None = None) -> Detection:
        """All surfaces' contact with themselves at positions x [mm], shape (n, 3); `earlier` as in `detection`."""
        return Detection.together([detect(surface, x, earlier) for surface in self.surfaces])

    def solve(
        self, problem: Problem, point: Point, rest: Floats, watch: Watch
    ) -> tuple[Point, Reason, dict[str, float]]:
        """Continue from the solution without contact; the point, why it stopped, and counts for `Solution.detail`.

        Each round freezes the gaps where contact is, descends on energy and contact together, and takes the forces
        found for multipliers of the next round's gaps (the method of multipliers, with the geometry brought up to
        date), until nothing is deeper than PARTED; the last descent goes on to the watch's own threshold. Where the
        depth does not fall any more, the least deep point found is returned with Reason.CONTACT.
        """
        before = found = self.detect(rest + point.u)
        reason, rounds, place = Reason.CONVERGED, 0, point.place
        tight = found.depth <= PARTED
        if found.depth > STEP:
            place, found = approach(self.elasticity, self.detect, rest, place, self.vertices)
        rows, best, since = found.rows, (point, before), 0
        while not (tight and found.depth <= ALLOWED_DEPTH):
            if since == PATIENCE:
                point, found, reason = *best, Reason.CONTACT
                break
            tight = found.depth <= PARTED
            touching = self._with(problem, rows, rest, place)
            first = touching.at(place)
            watch.forget()
            point, reason = lbfgs(touching, first, watch if tight else Loosely(watch, LOOSE * first.norm))
            if reason is Reason.STAGNATED and watch.best is not None:
                point = watch.best
            place, x, rounds = point.place, rest + point.u, rounds + 1
            rows = rows.updated(x)
            found = self.detect(x, rows)
            if reason not in SOLVED:
                break
            rows = found.rows.carrying(rows)
            since += 1
            if found.depth < 0.9 * best[1].depth:
                best, since = (point, found), 0
        return point, reason, _detail(before, found, rounds)

    def _with(self, problem: Problem, rows: Constraints, rest: Floats, place: Place) -> Problem:
        """The problem with contact in its energy, and in its matrix where it pushes."""
        matrix = self.elasticity.with_rows(rows, place)

        def at(ahead: Place) -> Point:
            point = problem.at(ahead)
            gradient = np.zeros_like(rest)
            energy = rows.add_to(rest + ahead.u, gradient)
            pulled = self.elasticity.system.coordinates.pull(gradient, ahead)
            return Point(ahead, point.energy + energy, point.gradient + pulled)

        def precondition(vector: Floats, near: Point) -> Floats:
            return matrix.solve(vector, rows.forces(rest + near.u) > 0.0, near.place.rotations)

        return Problem(at, problem.move, precondition)


def _detail(before: Detection, after: Detection, rounds: int) -> dict[str, float]:
    """For `Solution.detail`: crossing pairs of triangles, greatest depths [mm], rounds."""
    return {
        "contact_pairs_before": float(before.pairs),
        "contact_pairs_after": float(after.pairs),
        "contact_depth_before": before.depth,
        "contact_depth_after": after.depth,
        "contact_rounds": float(rounds),
    }


STEP = 1.0
"""The way [mm] that no vertex of the surface goes further than between two looks for contact."""
LOOKS = 3
"""Rounds of looking and pushing at one place at most."""
NEARLY = 0.1
"""The depth [mm] with which the way goes on."""
SWEEPS = 200
"""Gauss-Seidel sweeps at most; the descent that follows makes up for what they leave."""


@njit(cache=True)
def _dual(matrix, gaps, forces):
    """Projected Gauss-Seidel on the dual, from `forces` on, in place."""
    for _ in range(SWEEPS):
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


def approach(
    elasticity: Elasticity,
    detect: Callable[[Floats, Constraints | None], Detection],
    rest: Floats,
    end: Place,
    vertices: Ints,
) -> tuple[Place, Detection]:
    """A place like `end` that is not overlapped as deeply, and the contact there, with its forces for multipliers.

    rest [mm], shape (n, 3); vertices (k,) are those of the surfaces.
    """
    moved = end.u[vertices]
    steps = max(1, int(np.ceil(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max() / STEP)))
    coordinates = elasticity.system.coordinates
    place = force_free = coordinates.start(0.0 * end.u)
    found = detect(rest + place.u, None)
    for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
        ahead = coordinates.start(share * end.u)
        # Where contact pushed so far is a better place to look than where nothing did.
        place = coordinates.start(place.u + ahead.u - force_free.u)
        force_free = ahead
        for _ in range(LOOKS):
            found = detect(rest + place.u, found.rows)
            place, found = _pushed(elasticity, rest, force_free, found)
            if found.depth <= NEARLY:
                break
    return place, found


def _pushed(elasticity: Elasticity, rest: Floats, force_free: Place, found: Detection) -> tuple[Place, Detection]:
    rows = found.rows
    if not len(rows.ids):
        return force_free, found
    gradients, compliance = elasticity.of(rows, force_free)
    forces = rows.multipliers.copy()
    _dual(compliance + np.diag(1.0 / rows.stiffness), rows.gaps(rest + force_free.u), forces)
    step = elasticity.system.solve(gradients.T @ forces, force_free.rotations)
    place = elasticity.system.coordinates.move(force_free, step)
    return place, replace(found, rows=replace(rows, multipliers=forces))
