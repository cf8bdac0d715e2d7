"""What a scene costs: seconds of its parts, iterations and memory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..reference import Scene, Solution, prepare, terms
from .apart import forget_peak, held_megabytes, peak_megabytes
from .traces import Stopwatch


def timed(make: Callable[[], Scene], tolerance: float) -> tuple[Solution, dict]:
    """Make, prepare and solve a scene from rest; the solution, and wall and processor time [s] and iterations."""
    watch = Stopwatch()
    scene = make()
    laps = [watch.lap()]
    prepared = prepare(scene)
    laps.append(watch.lap())
    solution = prepared.solve(tolerance=tolerance)
    laps.append(watch.lap())
    walls = dict(zip(("scene_seconds", "prepare_seconds", "solve_seconds"), (wall for wall, _ in laps), strict=True))
    return solution, {
        **walls,
        "seconds": float(np.sum([wall for wall, _ in laps])),
        "cpu_seconds": float(np.sum([cpu for _, cpu in laps])),
        "iterations": solution.iterations,
        "converged": solution.converged,
        "reason": str(solution.reason),
        "detail": dict(solution.detail),
    }


def megabytes(make: Callable[[], Scene], *, iterations: int = 20) -> float:
    """The most memory [MB] that making, preparing and solving a scene takes beside what this process holds.

    To be called in a process of its own, before other scenes: what is freed is used again unseen.
    """
    _load_kernels()
    forget_peak()
    before = held_megabytes()
    prepare(make()).solve(max_iterations=iterations)
    return peak_megabytes() - before


def _load_kernels() -> None:
    """Solve a scene of one tet, which compiles what is compiled when it is first called, or reads it from the disk."""
    vertices = np.vstack([np.zeros(3), np.eye(3)])
    ids = np.arange(4)
    parts = (
        terms.Strain(1.0),
        terms.Volume(1.0),
        terms.SurfaceStrain(np.array([[1, 2, 3]]), 1.0),
        terms.Target(ids, 1.1 * vertices, 1.0),
    )
    prepare(Scene(vertices, np.array([[0, 1, 2, 3]]), parts)).solve()
