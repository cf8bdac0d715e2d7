"""Contact as a solve that follows the one without (SoftDECA 3.3.2): look for it, push apart, look again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...solution import Reason
from ...terms import Contact
from ..coordinates import Place
from ..descent import Point, Problem, Watch, lbfgs
from ..system import System
from .approach import STEP, approached
from .compliance import Elasticity
from .detection import Detection, detect
from .rows import Rows
from .surface import ContactSurface

PATIENCE = 10
"""Rounds without a lesser depth after which contact is given up."""
ALLOWED = 0.05
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
class Following:
    """The surfaces of a scene's Contact terms, and what of A⁻¹ between their vertices was asked for so far."""

    surfaces: tuple[ContactSurface, ...]
    vertices: Ints
    elasticity: Elasticity

    @classmethod
    def of(cls, scene: Scene, system: System) -> Following:
        """Raise SceneError for triangles that are not the tets' surface."""
        surfaces = tuple(ContactSurface.of(scene, term) for term in scene.of(Contact))
        vertices = np.unique(np.concatenate([surface.ids for surface in surfaces]))
        return cls(surfaces, vertices, Elasticity(system, vertices))

    def detect(self, x: Floats, earlier: Rows | None = None) -> Detection:
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
            place, found = approached(self.elasticity, self.detect, rest, place, self.vertices)
        rows, best, since = found.rows, (point, before), 0
        while not (tight and found.depth <= ALLOWED):
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

    def _with(self, problem: Problem, rows: Rows, rest: Floats, place: Place) -> Problem:
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
