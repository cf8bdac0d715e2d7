"""How far a place is from the minimum: Newton's step by conjugate gradients, the Hessian at rest before them.

A few products do, since the Hessian at an answer near by is close: after one, the length of the step is right within a
tenth on most frames of a face. Where tets fold, the Hessian may have negative curvature; the step then ends before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ..descent import Objective, Point
from ..policy import POLICY, NewtonStepPolicy


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """A step over the unknowns [mm].

    is_near: it came near its end, without negative curvature. products: with the Hessian, each an evaluation.
    """

    step: Floats
    is_near: bool
    products: int


def newton_step(
    problem: Objective, point: Point, vertices: Ints | slice, policy: NewtonStepPolicy = POLICY.newton_step
) -> NewtonStep:
    """Solve for Newton's step by conjugate gradients (Nocedal and Wright 2006, Algorithm 7.1).

    `problem.precondition` solves with the Hessian near by, whose own step for the residual that is left is added.
    vertices: those whose motion says whether the step is near its end.
    """

    def motion(step: Floats) -> float:
        moved = problem.move(point.place, step).u - point.u
        return float(np.linalg.norm(moved[vertices], axis=1).mean())

    residual = -point.gradient
    rest = problem.precondition(residual, point)
    step, direction = np.zeros_like(rest), rest
    descent = float(np.dot(residual, rest))
    for products in range(1, policy.most_products + 1):
        product = _multiply_hessian(problem, point, direction, policy.difference)
        curvature = float(np.dot(direction, product))
        if not curvature > 0.0:
            return NewtonStep(step + rest, descent == 0.0, products)
        step = step + (descent / curvature) * direction
        residual = residual - (descent / curvature) * product
        rest = problem.precondition(residual, point)
        if motion(rest) <= policy.near * motion(step + rest):
            return NewtonStep(step + rest, True, products)
        before, descent = descent, float(np.dot(residual, rest))
        direction = rest + (descent / before) * direction
    return NewtonStep(step + rest, False, policy.most_products)


def _multiply_hessian(problem: Objective, point: Point, direction: Floats, difference: float) -> Floats:
    """Multiply a direction by the Hessian, by two gradients at most `difference` [mm] apart."""
    size = difference / max(float(np.abs(direction).max()), float(np.finfo(np.float64).tiny))
    ahead = problem.after(point, size * direction)
    product: Floats = (ahead.gradient - point.gradient) / size
    return product
