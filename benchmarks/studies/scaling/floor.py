"""How fast an iteration of projective dynamics could be: the bytes it must read over the bandwidth of memory."""

from __future__ import annotations

import time
from collections.abc import Callable

import numba
import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import splu

from ....lhm.base.mesh import Floats
from ....reference.projective import ProjectivePrepared
from ....reference.projective.terms.tets import TetBlocks

TRIAD_NUMBERS = 8_000_000
"""Per array: 64 MB, beyond the caches of a core."""
REPEATS = 15


@numba.njit(cache=True)
def _triad(a, b, c, factor):
    for i in range(len(a)):
        a[i] = b[i] + factor * c[i]


def measure_bandwidth() -> float:
    """Measure bytes per second that one core moves in the triad a = b + s c (McCalpin's STREAM), best of some runs."""
    a, b, c = (np.full(TRIAD_NUMBERS, value) for value in (0.0, 1.0, 2.0))
    _triad(a, b, c, 3.0)
    seconds = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        _triad(a, b, c, 3.0)
        seconds.append(time.perf_counter() - begin)
    return 3 * a.nbytes / min(seconds)


def count_factor_bytes(prepared: ProjectivePrepared) -> int:
    """Count bytes of the triangular factors of A, counted by SuperLU's symmetric minimum-degree order."""
    matrix, _ = prepared.energy.matrix(prepared.scene)
    total = 0
    for _, free in prepared.system.coordinates.groups:
        if len(free):
            reduced = matrix[free][:, free].tocsc()
            shifted = reduced + 1e-9 * np.mean(reduced.diagonal()) * identity(len(free), format="csc")
            lu = splu(
                shifted.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
            total += 12 * lu.L.nnz  # a value in float64 and a row in int32
    return total


def count_tet_bytes(prepared: ProjectivePrepared) -> int:
    """Count bytes of parameters and corners of all tets, which the local step reads."""
    tets = prepared.energy.part(TetBlocks)
    return 0 if tets is None else tets.parameters.nbytes + tets.corners.nbytes


def split_iteration(prepared: ProjectivePrepared, positions: Floats, iteration_seconds: float) -> dict[str, float]:
    """Split an iteration's seconds into those [ms] of the energy's gradient, of the solve with A, and the rest.

    Both are timed at the positions [mm], shape (n, 3).
    """
    coordinates = prepared.system.coordinates
    place = coordinates.start(positions - prepared.scene.vertices)
    energy = prepared.energy.for_scene(prepared.scene)
    gradient = coordinates.pull(energy.evaluate(place.u)[1], place)
    local = _measure_median(lambda: energy.evaluate(place.u))
    solve = _measure_median(lambda: prepared.system.solve(gradient, place.rotations))
    return {
        "iteration": 1e3 * iteration_seconds,
        "local": 1e3 * local,
        "solve": 1e3 * solve,
        "rest": 1e3 * (iteration_seconds - local - solve),
    }


def _measure_median(work: Callable[[], object]) -> float:
    work()
    seconds = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))
