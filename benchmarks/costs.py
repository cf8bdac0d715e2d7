"""What a solve costs, in the words of every study: seconds of its parts, iterations and memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from ..lhm.base.mesh import Floats
from ..reference import Scene, Solution, prepare, ranks, terms
from .harness.apart import forget_peak, held_megabytes, peak_megabytes
from .harness.study import Column, Values
from .traces import Stopwatch

BUDGET = 30.0
"""Seconds after which a solve is repeated no more."""
Result = TypeVar("Result")
PD_ENERGY, NEO_HOOKEAN = "PD", "neo-Hookean"
"""What studies call the energy of a scene as it is, and of one with that law."""
TIMES = (
    Column("scene_s", "scene [s]", cost=True),
    Column("prepare_s", "prepare [s]", cost=True),
    Column("solve_s", "solve [s]", cost=True),
    Column("cpu_s", "processor time of all three [s]", cost=True),
)
COUNTS = (
    Column("iterations", "iterations", cost=True),
    Column("linear_iterations", "CG iterations", cost=True),
)
ENDED = Column("reason", "ended")
MEMORY = Column("scene_mb", "scene and solver [MB]", cost=True)


def timed(make: Callable[[], Scene], tolerance: float, *, start: Floats | None = None, **how) -> tuple[Solution, dict]:
    """Make, prepare and solve a scene, by `how` as `prepare` takes it; the solution, and the values of the columns."""
    watch = Stopwatch()
    scene = make()
    laps = [watch.lap()]
    prepared = prepare(scene, **how)
    laps.append(watch.lap())
    solution = prepared.solve(tolerance=tolerance, start=start)
    laps.append(watch.lap())
    walls = dict(zip(("scene_s", "prepare_s", "solve_s"), (wall for wall, _ in laps), strict=True))
    return solution, {**walls, "cpu_s": float(np.sum([cpu for _, cpu in laps])), **counts(solution)}


def again(work: Callable[[], Result], repeats: int) -> list[Result]:
    """What `work` returns, so often, after one call that is not counted; less often where that takes over BUDGET."""
    work()
    found: list[Result] = []
    begin = time.perf_counter()
    while not found or ranks.first(len(found) < repeats and time.perf_counter() - begin < BUDGET):
        found.append(work())
    return found


def counts(solution: Solution) -> dict:
    """How often a solver iterated, its linear solver where it counts, and why it ended."""
    return {
        "iterations": solution.iterations,
        "linear_iterations": solution.detail.get("linear_iterations"),
        "converged": solution.converged,
        "reason": solution.reason.name,
    }


def repeated(rows: Sequence[Values]) -> dict:
    """Rows of one measure, repeated, as one: times as lists, what does not differ as it is."""
    return {key: [row[key] for row in rows] if key.endswith("_s") else value for key, value in rows[0].items()}


def unfinished(rows: Sequence[Values]) -> int:
    """How many solves of the rows' values did not reach what was asked."""
    return sum(not values["converged"] for values in rows)


def slope(sizes: Sequence[float], values: Sequence[float | None]) -> float | None:
    """The exponent of a figure over sizes, by least squares of logarithms; None where it is not there, or one only."""
    if len(set(sizes)) < 2 or not all(values):
        return None
    return float(np.polyfit(np.log(sizes), np.log(np.asarray(values, dtype=np.float64)), 1)[0])


def megabytes(make: Callable[[], Scene], *, iterations: int = 20, **how) -> float:
    """The most memory [MB] that making, preparing and solving a scene takes beside what this process holds.

    To be called in a process of its own, before other scenes: what is freed is used again unseen.
    """
    load_kernels(**how)
    forget_peak()
    before = held_megabytes()
    prepare(make(), **how).solve(max_iterations=iterations)
    return peak_megabytes() - before


def load_kernels(**how) -> None:
    """Solve a scene of one tet, which compiles what is compiled when it is first called, or reads it from the disk."""
    vertices = np.vstack([np.zeros(3), np.eye(3)])
    ids = np.arange(4)
    parts = (
        terms.Strain(1.0),
        terms.Volume(1.0),
        terms.SurfaceStrain(np.array([[1, 2, 3]]), 1.0),
        terms.Target(ids, 1.1 * vertices, 1.0),
    )
    prepare(Scene(vertices, np.array([[0, 1, 2, 3]]), parts), **how).solve()
