"""One solve as seen from the truth: error, time and gradient, iteration by iteration."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..lhm.base.mesh import Floats
from ..reference import Solution
from ..reference.projective import ProjectivePrepared
from ..reference.solve import Prepared

TIGHT = 1e-10
"""Gradient norm relative to its start at which a truth is taken."""
ACCURACY = 0.01
"""[mm], the largest distance of any vertex from the truth that a frame may have."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Per iteration, the start first: time [s], largest distance of a vertex from the truth [mm], gradient norm [1].

    The gradient norm is over that of the start.
    """

    seconds: Sequence[float]
    error: Sequence[float]
    gradient: Sequence[float]

    def settled(self, bound: float) -> int | None:
        """The iteration from which on the error stays at most `bound` [mm]; None if the last one is above."""
        above = np.flatnonzero(~(np.asarray(self.error) <= bound))
        first = int(above[-1]) + 1 if above.size else 0
        return first if first < len(self.error) else None

    def seconds_to(self, bound: float) -> float | None:
        """Time [s] from which on the error stays at most `bound` [mm], None if it does not."""
        at = self.settled(bound)
        return None if at is None else float(self.seconds[at])

    def tolerance_for(self, bound: float) -> float | None:
        """The tolerance with which this solve stops at the first iteration from which its error is at most `bound`."""
        at = self.settled(bound)
        return None if at is None else float(np.min(self.gradient[: at + 1]))


def traced(
    prepared: Prepared,
    truth: Floats,
    *,
    start: Floats | None = None,
    tolerance: float = TIGHT,
    max_iterations: int | None = None,
    enough: float = -1.0,
) -> tuple[Solution, Trace]:
    """Solve and compare each iteration with the truth [mm], (n, 3); stop where the error is at most `enough` [mm].

    What the comparison costs does not count.
    """
    error: list[float] = []

    def see(iteration: int, positions: Floats, energy: float, gradient_norm: float) -> bool:
        error.append(farthest(positions, truth))
        return error[-1] <= enough

    solution = prepared.solve(start=start, tolerance=tolerance, max_iterations=max_iterations, on_iteration=see)
    return solution, _trace(solution, error)


def traced_to_itself(prepared: Prepared | ProjectivePrepared, *, tolerance: float = TIGHT) -> tuple[Solution, Trace]:
    """A tight solve as seen from its own end, to 1e-5 mm: positions on the way are kept in float32."""
    visited: list[np.ndarray] = []

    def see(iteration: int, positions: Floats, energy: float, gradient_norm: float) -> bool:
        visited.append(positions.astype(np.float32))
        return False

    solution = prepared.solve(tolerance=tolerance, on_iteration=see)
    return solution, _trace(solution, [farthest(x, solution.positions) for x in visited])


def _trace(solution: Solution, error: Sequence[float]) -> Trace:
    norms = solution.history.gradient_norm
    return Trace(solution.history.time.tolist(), error, (norms / max(norms[0], 1e-300)).tolist())


def farthest(a: Floats, b: Floats) -> float:
    """The largest distance [mm] of two arrays of points, both (n, 3)."""
    return float(np.linalg.norm(a - b, axis=1).max())


class Stopwatch:
    """Wall and processor time [s] since it was made or last read."""

    def __init__(self):
        self._begin = time.perf_counter(), time.process_time()

    def lap(self) -> tuple[float, float]:
        """Wall and processor time since the last lap."""
        now = time.perf_counter(), time.process_time()
        wall, cpu = now[0] - self._begin[0], now[1] - self._begin[1]
        self._begin = now
        return wall, cpu
