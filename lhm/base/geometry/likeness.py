"""Whether positions can be a neutral surface that an expression has moved: unit, place, orientation, order of vertices.

Measured on two spaces of heads (Anny, ICT-FaceKit): single expressions, all 52 at once and random ones, on 20 people
each, and faces that settle at the ends of every parameter. The bounds lie between these and what is wrong.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..errors import InputError, SoftdecaError
from ..mesh import Floats, Floats32, Ints, Surface

FARTHEST = 100.0
"""[mm] From the neutral surface; expressions move at most 71."""
SIZES = 0.8, 1.25
"""Of the neutral surface's size; expressions and p: 0.96 to 1.06, metres 0.001."""
LEAST_LIKENESS = 0.8
"""Cosine between both surfaces' vertices about their means; expressions and p: 0.98, mirrored 0.5, shuffled 0."""
MOST_STRETCH = 1.6
"""Of edges, root mean square; expressions and p: 1.09, vertices shifted by one place 4.9."""
TRIANGLES = 300
"""How many are looked at, about: the order of vertices is right or wrong everywhere."""


def check_moved(
    name: str,
    neutral: Surface,
    positions: Floats | Floats32,
    *,
    of: str = "the neutral skin",
    error: type[SoftdecaError] = InputError,
) -> None:
    """Raise `error`, naming `name`, for positions [mm], shape (n, 3), that no expression makes of a neutral surface.

    They are in another unit, elsewhere, mirrored, turned, or in another order; or not finite.
    """
    vertex, away, size, likeness, stretch = _compare(neutral.vertices, neutral.triangles, positions)
    if not np.isfinite(size) and (count := np.count_nonzero(~np.isfinite(positions))):
        raise error(f"{name}: {count} values are not finite")
    if not SIZES[0] <= size <= SIZES[1]:
        raise error(
            f"{name}: {size:.3g} times as large as {of}, expected {SIZES[0]:g} to {SIZES[1]:g}; are its units off?"
        )
    if not likeness >= LEAST_LIKENESS:
        raise error(
            f"{name}: its likeness to {of} is {likeness:.2f}, expected at least {LEAST_LIKENESS:g}; "
            "is it mirrored, turned, or in another order of vertices?"
        )
    if not stretch <= MOST_STRETCH:
        raise error(
            f"{name}: its edges are {stretch:.3g} times as long as those of {of}, expected at most "
            f"{MOST_STRETCH:g}; are its vertices in another order?"
        )
    if not away <= FARTHEST:
        raise error(
            f"{name}: vertex {vertex} is {away:.4g} mm from {of}, expected at most {FARTHEST:g} mm; "
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
