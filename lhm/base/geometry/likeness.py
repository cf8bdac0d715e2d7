"""Whether positions can be a neutral surface that an expression has moved: their unit, and how far they lie from it."""

from __future__ import annotations

import numpy as np

from ..errors import InputError, SoftdecaError
from ..kernels import njit
from ..mesh import Floats, Floats32, Surface

FARTHEST = 100.0
"""[mm] Expressions of Anny's and ICT-FaceKit's people move vertices by at most 71; mirroring a head, by more."""
LEAST_SIZE, MOST_SIZE = 0.8, 1.25
"""Size over the neutral surface's: expressions and p make 0.96 to 1.06, metres 0.001."""


def check_moved(
    name: str,
    neutral: Surface,
    positions: Floats | Floats32,
    *,
    reference: str = "the neutral skin",
    error: type[SoftdecaError] = InputError,
) -> None:
    """Raise `error`, naming `name`, for positions [mm], shape (n, 3), that no expression makes of a neutral surface."""
    size, vertex, away = _compare(neutral.vertices, positions)
    if not np.isfinite(size) and (count := np.count_nonzero(~np.isfinite(positions))):
        raise error(f"{name}: {count} values are not finite")
    if not LEAST_SIZE <= size <= MOST_SIZE:
        raise error(
            f"{name}: {size:.3g} times as large as {reference}, expected {LEAST_SIZE:g} to {MOST_SIZE:g}; "
            "are its units off?"
        )
    if not away <= FARTHEST:
        raise error(
            f"{name}: vertex {vertex} is {away:.4g} mm from {reference}, expected at most "
            f"{FARTHEST:g} mm; is it mirrored, turned, in another unit or order of vertices?"
        )


@njit(cache=True, fastmath={"reassoc", "contract"})  # sums in any order; NaN and infinity stay what they are
def _compare(rest, moved) -> tuple[float, int, float]:
    """Return the size of `moved` over that at rest, and the vertex that is farthest away, with its distance [mm]."""
    n = len(rest)
    middle, centre, farthest, vertex = np.zeros(3), np.zeros(3), 0.0, 0
    for i in range(n):
        away = 0.0
        for c in range(3):
            middle[c] += rest[i, c]
            centre[c] += moved[i, c]
            away += (moved[i, c] - rest[i, c]) ** 2
        if away > farthest:
            farthest, vertex = away, i
    square, other = 1e-300, 0.0
    for i in range(n):
        for c in range(3):
            square += (rest[i, c] - middle[c] / n) ** 2
            other += (moved[i, c] - centre[c] / n) ** 2
    return np.sqrt(other / square), vertex, np.sqrt(farthest)
