"""Frames of a settled face on the way from first order to the answer, and how far there is still to go.

L-BFGS with the PD matrix settles what is local, even where tets fold. Newton's step, solved for with the factored
Hessian at rest, says how far the answer is, and leads there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Floats32
from ..projective.descent import Point, Problem, lbfgs_step, search_line
from ..projective.energy import Energy
from ..projective.memory import Memory
from ..projective.newton_step import NewtonStep, newton_step
from ..projective.springs import Springs
from . import palsy
from .derivatives import FaceDerivatives, spring_norm
from .facial import PD_ENERGY

STEP_HALVINGS = 3
"""Halvings of Newton's step before it is given up: where tets fold, its model may hold for less."""


@dataclass(frozen=True, eq=False)
class FaceFrames:
    """A settled face to first order, ready to correct frames.

    deltas (k, skin vertices, 3) [mm]: what each shape adds to the skin. first_order (k, n, 3) [mm]: how the scene's
    vertices move with each; goals (k, targets, 3) [mm]: how the targets do.
    """

    linear: FaceDerivatives
    deltas: Floats
    first_order: Floats
    goals: Floats

    @classmethod
    def from_face(cls, linear: FaceDerivatives, deltas: Floats | Floats32) -> FaceFrames:
        """Differentiate by shapes. SceneError for a face of another law, or with choices of its scenes."""
        face = linear.face
        if face.choices or face.law != PD_ENERGY:
            raise SceneError("a face is corrected by PD's energy, and without choices of its scenes")
        springs = palsy.Springs.from_head(face.head, face.parameters)
        shapes = np.asarray(deltas, dtype=np.float64)
        goals = springs.move(np.stack([face.head.wrap_from_skin @ shape for shape in shapes]))
        return cls(linear, shapes, linear.tangent.vertices_by_targets(goals), goals)

    def expression(self, weights: Floats) -> Floats:
        """Blend the head's skin without p [mm], shape (skin vertices, 3), of weights (k,)."""
        return self.linear.face.head.skin.vertices + _combine(weights, self.deltas)

    def predict(self, weights: Floats) -> Floats:
        """Predict the scene's vertices [mm], shape (n, 3), to first order."""
        return self.linear.answer.positions + _combine(weights, self.first_order)

    def begin(self, weights: Floats, start: Floats | None = None) -> Correction:
        """Begin a frame of weights (k,) at `start` [mm], shape (n, 3), by default the first order."""
        scene, system = self.linear.prepared.scene, self.linear.prepared.system
        moved = _combine(weights, self.goals)
        parts = self.linear.prepared.energy.parts
        energy = Energy(tuple(part.shift(moved) if isinstance(part, Springs) else part for part in parts))
        start = self.predict(weights) if start is None else start
        return Correction(self, np.asarray(weights), energy, system.coordinates.start(start - scene.vertices))


class Correction:
    """One frame on its way: `point` is where it is, `solves` counts those with either matrix.

    `size` [mN] is the gradient norm of the targets' springs each 1 mm long.
    """

    def __init__(self, frames: FaceFrames, weights: Floats, energy: Energy, place):
        self.frames, self.weights, self._energy = frames, weights, energy
        linear = frames.linear
        self.size = spring_norm(linear.prepared.scene)
        self._coordinates = linear.prepared.system.coordinates
        self._memory = Memory(self._coordinates.size)
        self._problem = Problem(self._at, self._coordinates.move, self._solve_matrix, bounded=False)
        self._newton = Problem(self._at, self._coordinates.move, self._solve_tangent, bounded=False)
        self.solves = 0
        self.point = self._at(place)

    @property
    def positions(self) -> Floats:
        """The scene's vertices [mm], shape (n, 3)."""
        positions: Floats = self.frames.linear.prepared.scene.vertices + self.point.u
        return positions

    @property
    def residual(self) -> float:
        """The gradient norm relative to `size`."""
        return self.point.norm / self.size

    def smooth(self, iterations: int, *, until: float = 0.0) -> None:
        """Run so many iterations of L-BFGS with the PD matrix, at least one, or until the residual is small enough."""
        for _ in range(iterations):
            self.point = lbfgs_step(self._problem, self.point, self._memory)
            if self.residual <= until:
                break

    def newton_step(self) -> NewtonStep:
        """Solve for Newton's step from here; whether it is near its end is asked of the skin wrap."""
        return newton_step(self._newton, self.point, slice(len(self.frames.linear.face.head.bone)))

    def rough_step(self) -> Floats:
        """Solve for the step by the Hessian at rest alone."""
        return self._solve_tangent(-self.point.gradient, self.point)

    def take(self, step: Floats) -> bool:
        """Go along a step as far as the energy falls enough; False, and nothing moves, where it does not soon."""
        taken = search_line(self._problem, self.point, step, STEP_HALVINGS)
        if taken is None:
            return False
        step, ahead = taken
        self._memory.add(step, ahead.gradient - self.point.gradient)
        self.point = ahead
        return True

    def move_wrap(self, step: Floats) -> Floats:
        """Displace the skin wrap [mm], shape (wrap vertices, 3), by a step over the unknowns."""
        ahead = self._coordinates.move(self.point.place, step)
        return (ahead.u - self.point.u)[: len(self.frames.linear.face.head.bone)]

    def skin(self) -> Floats:
        """Return the skin [mm], shape (skin vertices, 3)."""
        return self.frames.linear.face.skin_after(self.frames.expression(self.weights), self.positions)

    def _at(self, place) -> Point:
        energy, gradient = self._energy.evaluate(place.u)
        return Point(place, energy, self._coordinates.pull(gradient, place))

    def _solve_tangent(self, vector: Floats, point: Point) -> Floats:
        self.solves += 1
        return self.frames.linear.tangent.solve(vector)

    def _solve_matrix(self, vector: Floats, point: Point) -> Floats:
        self.solves += 1
        return self.frames.linear.prepared.system.solve(vector, point.place.rotations)


def _combine(weights: Floats, shapes: Floats) -> Floats:
    """Sum shapes (k, n, 3) by weights (k,), those of zero left out."""
    used = np.flatnonzero(weights)
    combined: Floats = np.tensordot(np.asarray(weights, dtype=np.float64)[used], shapes[used], axes=1)
    return combined
