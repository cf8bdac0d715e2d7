"""Frames of a settled face on the way from first order to the answer, and how far there is still to go.

L-BFGS with the PD matrix settles what is local, even where tets fold. Newton's step, solved for with the factored
Hessian at rest, says how far the answer is, and leads there.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats
from ..projective.descent import Objective, Point, lbfgs_step, search_line
from ..projective.hessian.newton_step import NewtonStep, newton_step
from ..projective.memory import Memory
from ..projective.terms.energy import Energy
from ..projective.terms.springs import Springs
from .derivatives import spring_norm
from .face import Face


def predict(face: Face, weights: Floats) -> Floats:
    """Predict the vertices of an expression's scene [mm], shape (n, 3), to first order."""
    return face.derivatives.answer.positions + _combine(weights, face.first_order)


class Correction:
    """A frame of weights (52,) on its way, begun at `start` [mm], by default the first order.

    `point` is where it is, `solves` counts those with either matrix. `size` [mN] is the gradient norm of the targets'
    springs each 1 mm long.
    """

    def __init__(self, face: Face, weights: Floats, start: Floats | None = None):
        self.face, self.weights = face, weights
        self._linear = face.derivatives
        prepared = self._linear.prepared
        self.size = spring_norm(prepared.scene)
        start = predict(face, weights) if start is None else start
        if face.goals is None:
            scene = face.scene(weights)
            prepared.scene.check_prepared_for(scene)
            self._energy = prepared.energy.for_scene(scene)
            start = np.where(*scene.dirichlet(), start)
        else:
            motion = _combine(weights, face.goals)
            self._energy = Energy(
                tuple(part.shift(motion) if isinstance(part, Springs) else part for part in prepared.energy.parts)
            )
        self._coordinates = prepared.system.coordinates
        self._memory = Memory(self._coordinates.size)
        self._problem = Objective(self._evaluate, self._coordinates.move, self._solve_matrix, bounded=False)
        self._newton = Objective(self._evaluate, self._coordinates.move, self._solve_tangent, bounded=False)
        self.solves = 0
        self.point = self._evaluate(self._coordinates.start(start - prepared.scene.vertices))

    @property
    def expression(self) -> Floats:
        """The blended shapes S [mm], shape (n, 3)."""
        return self.face.skin.vertices + _combine(self.weights, self.face.shapes)

    @property
    def positions(self) -> Floats:
        """The scene's vertices [mm], shape (n, 3)."""
        positions: Floats = self._linear.prepared.scene.vertices + self.point.u
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
        return newton_step(self._newton, self.point, slice(len(self.face.head.bone)))

    def rough_step(self) -> Floats:
        """Solve for the step by the Hessian at rest alone."""
        return self._solve_tangent(-self.point.gradient, self.point)

    def take(self, step: Floats) -> bool:
        """Go along a step as far as the energy falls enough; False, and nothing moves, where it does not soon."""
        # Halvings: where tets fold, the model may hold for less.
        result = search_line(self._problem, self.point, step, 3)
        if result is None:
            return False
        step, ahead = result
        self._memory.add(step, ahead.gradient - self.point.gradient)
        self.point = ahead
        return True

    def move_wrap(self, step: Floats) -> Floats:
        """Displace the skin wrap [mm], shape (wrap vertices, 3), by a step over the unknowns."""
        ahead = self._coordinates.move(self.point.place, step)
        return (ahead.u - self.point.u)[: len(self.face.head.bone)]

    def skin(self) -> Floats:
        """Return the skin [mm], shape (skin vertices, 3)."""
        return self.face.expression_skin(self.expression, self.positions)

    def _evaluate(self, place) -> Point:
        energy, gradient = self._energy.evaluate(place.u)
        return Point(place, energy, self._coordinates.pull(gradient, place))

    def _solve_tangent(self, vector: Floats, point: Point) -> Floats:
        self.solves += 1
        return self._linear.tangent.solve(vector)

    def _solve_matrix(self, vector: Floats, point: Point) -> Floats:
        self.solves += 1
        return self._linear.prepared.system.solve(vector, point.place.rotations)


def _combine(weights: Floats, shapes: Floats) -> Floats:
    """Sum shapes (k, n, 3) by weights (k,), those of zero left out."""
    used = np.flatnonzero(weights)
    combined: Floats = np.tensordot(np.asarray(weights, dtype=np.float64)[used], shapes[used], axes=1)
    return combined
