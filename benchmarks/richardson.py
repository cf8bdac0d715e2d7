"""Order and limit of answers on meshes that are halved, after Richardson, and Roache's grid convergence index."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..lhm.base.mesh import Floats

LEAST_ORDER, GREATEST_ORDER = 0.5, 2.0
"""Orders used for extrapolation; one that is seen outside of them is brought to the nearer end."""
SAFETY_OF_THREE = 1.25
SAFETY_OF_TWO = 3.0
"""Roache's factors of safety: three meshes show their order, with two it is taken on trust."""


@dataclass(frozen=True, eq=False)
class Limit:
    """Where a sequence of answers goes.

    `positions` [mm], shape (n, 3), of the limit; `observed` order (None where two answers are the same or there are
    only two), the order `used`, and `index` [mm]: the GCI, a bound of the finest answer's RMS error.
    """

    positions: Floats
    observed: float | None
    used: float
    index: float


def rms(difference: Floats) -> float:
    """Root mean square of the lengths of vectors (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def limit_of_three(coarse: Floats, middle: Floats, fine: Floats) -> Limit:
    """The limit [mm] of answers (n, 3) on meshes each of half the last one's size; the order is what they show."""
    first, second = rms(middle - coarse), rms(fine - middle)
    if second == 0.0:
        return Limit(fine, None, GREATEST_ORDER, 0.0)
    observed = math.log2(first / second) if first > 0.0 else -math.inf
    used = min(max(observed, LEAST_ORDER), GREATEST_ORDER)
    step = (fine - middle) / (2.0**used - 1.0)
    return Limit(fine + step, observed if math.isfinite(observed) else None, used, SAFETY_OF_THREE * rms(step))


def limit_of_two(coarse: Floats, fine: Floats, order: float) -> Limit:
    """The limit [mm] of answers (n, 3) on a mesh and one of half its size, for an order that is assumed."""
    step = (fine - coarse) / (2.0**order - 1.0)
    return Limit(fine + step, None, order, SAFETY_OF_TWO * rms(step))
