"""Whether positions can be a neutral surface that an expression has moved: unit, place, orientation, order of vertices.

Measured on two spaces of heads (Anny, ICT-FaceKit): single expressions, all 52 at once and random ones, on 20 people
each, and faces that settle at the ends of every parameter. The bounds lie between these and what is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..errors import InputError, SoftdecaError
from ..mesh import Floats, Floats32, Ints, Surface

TRIANGLES = 300
"""How many are looked at, about: the order of vertices is right or wrong everywhere."""


@dataclass(frozen=True)
class LikenessBounds:
    """Bounds of the changes that an expression makes to a neutral surface."""

    farthest: float = 100.0  # [mm] of a vertex; expressions move at most 71
    least_size: float = 0.8  # of the neutral surface's; expressions and p: 0.96 to 1.06, metres 0.001
    most_size: float = 1.25
    least_likeness: float = (
        0.8  # cosine of vertices about their means; expressions and p: 0.98, mirrored .5, shuffled 0
    )
    most_stretch: float = 1.6  # of edges, root mean square; expressions and p: 1.09, vertices shifted by one 4.9


BOUNDS = LikenessBounds()


def check_moved(
    name: str,
    neutral: Surface,
    positions: Floats | Floats32,
    *,
    reference: str = "the neutral skin",
    error: type[SoftdecaError] = InputError,
) -> None:
    """Raise `error`, naming `name`, for positions [mm], shape (n, 3), that no expression makes of a neutral surface.

    They are in another unit, elsewhere, mirrored, turned, or in another order; or not finite.
    """
    vertex, away, size, likeness, stretch = _compare(neutral.vertices, neutral.triangles, positions)
    if not np.isfinite(size) and (count := np.count_nonzero(~np.isfinite(positions))):
        raise error(f"{name}: {count} values are not finite")
    if not BOUNDS.least_size <= size <= BOUNDS.most_size:
        raise error(
            f"{name}: {size:.3g} times as large as {reference}, expected {BOUNDS.least_size:g} to "
            f"{BOUNDS.most_size:g}; are its units off?"
        )
    if not likeness >= BOUNDS.least_likeness:
        raise error(
            f"{name}: its likeness to {reference} is {likeness:.2f}, expected at least {BOUNDS.least_likeness:g}; "
            "is it mirrored, turned, or in another order of vertices?"
        )
    if not stretch <= BOUNDS.most_stretch:
        raise error(
            f"{name}: its edges are {stretch:.3g} times as long as those of {reference}, expected at most "
            f"{BOUNDS.most_stretch:g}; are its vertices in another order?"
        )
    if not away <= BOUNDS.farthest:
        raise error(
            f"{name}: vertex {vertex} is {away:.4g} mm from {reference}, expected at most {BOUNDS.farthest:g} mm; "
            "are its units off, or its place?"
        )


@njit(cache=True, fastmath={"reassoc", "contract"})  # sums in any order; NaN and infinity stay what they are
def _compare(rest: Floats, triangles: Ints, moved) -> tuple[int, float, float, float, float]:
    """Return the farthest vertex and its distance [mm], and moved's size, cosine and edges beside those at rest."""
    n = len(rest)
    middle, centre = np.zeros(3), np.zeros(3)
    for i in range(n):
        for c in range(3):
            middle[c] += rest[i, c]
            centre[c] += moved[i, c]
    middle, centre = middle / n, centre / n
    square, other, product, farthest, vertex = 0.0, 0.0, 0.0, 0.0, 0
    for i in range(n):
        away = 0.0
        for c in range(3):
            a, b = rest[i, c] - middle[c], moved[i, c] - centre[c]
            square += a * a
            other += b * b
            product += a * b
            away += (moved[i, c] - rest[i, c]) ** 2
        if away > farthest:
            farthest, vertex = away, i
    before, after = 0.0, 0.0
    for t in range(0, len(triangles), max(1, len(triangles) // TRIANGLES)):
        for k in range(3):
            i, j = triangles[t, k], triangles[t, k - 1]
            for c in range(3):
                before += (rest[i, c] - rest[j, c]) ** 2
                after += (moved[i, c] - moved[j, c]) ** 2
    tiny = 1e-300
    size = np.sqrt(other / (square + tiny))
    stretch = np.sqrt(after / (before + tiny)) / (size + tiny)
    return vertex, np.sqrt(farthest), size, product / (np.sqrt(square * other) + tiny), stretch
