"""Measures that studies share: distances, time, memory, a solve's error to the truth, and limits of meshes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...lhm.base.errors import SoftdecaError
from ...lhm.base.mesh import Floats
from ...reference import Scene, Solution, apply_law, prepare, solve, terms
from ...reference.face.facial import PD_ENERGY, FaceLaw
from ...reference.projective import ProjectivePrepared
from ...reference.solve import Prepared
from ..harness.study import Column, Values


def distances(a: Floats, b: Floats) -> Floats:
    """Measure the distance of each vertex [mm], shape (n,), of positions (n, 3)."""
    return np.linalg.norm(a - b, axis=1)


def difference(a: Floats, b: Floats, rest: Floats) -> dict[str, float]:
    """Measure vertices' distances [mm] of positions `a` to `b`, both (n, 3): mean and max.

    relative: max over the largest displacement of `b`, which is counted from `rest`.
    """
    d = distances(a, b)
    largest = largest_distance(b, rest)
    return {
        "mean": float(d.mean()),
        "max": float(d.max()),
        "relative": float(d.max() / largest) if largest > 0 else float(d.max() > 0),
    }


TIGHT = 1e-10
"""Gradient norm relative to its start at which a truth is taken."""
ACCURACY = 0.01
"""[mm], the largest distance of any vertex from the truth that a frame may have."""


def find_arrival(errors: Sequence[float], bound: float) -> int | None:
    """Find the number from which on errors [mm] stay at most `bound` [mm]; None if the last one is above."""
    above = np.flatnonzero(~(np.asarray(errors) <= bound))
    first = int(above[-1]) + 1 if above.size else 0
    return first if first < len(errors) else None


def solve_with_tolerance(prepared: Prepared | ProjectivePrepared, tolerance: float = TIGHT) -> tuple[Solution, float]:
    """Solve tightly; also the tolerance by which the solve stops where it comes to stay within ACCURACY of its end."""
    visited: list[np.ndarray] = []

    def see(iteration: int, positions: Floats, energy: float, gradient_norm: float) -> bool:
        visited.append(positions.astype(np.float32))
        return False

    solution = prepared.solve(tolerance=tolerance, on_iteration=see)
    arrival = find_arrival([largest_distance(x, solution.positions) for x in visited], ACCURACY)
    norms = solution.history.gradient_norm
    return solution, float(np.min(norms[: len(norms) if arrival is None else arrival + 1]) / max(norms[0], 1e-300))


def solve_to_end(scene: Scene, what: str, **how: Any) -> Solution:
    """Solve a scene by `how`, as `solve` takes it; SoftdecaError names `what` was solved and why it ended early."""
    solution = solve(scene, **how)
    if not solution.is_balanced:
        raise SoftdecaError(f"{what}: {solution.reason}")
    return solution


def largest_distance(a: Floats, b: Floats) -> float:
    """Give the largest distance [mm] of two arrays of points, both (n, 3)."""
    return float(distances(a, b).max())


TIMES = (
    Column("scene_s", "scene [s]", cost=True),
    Column("prepare_s", "prepare [s]", cost=True),
    Column("solve_s", "solve [s]", cost=True),
    Column("cpu_s", "all of it [s]", cost=True),
)
"""Processor times."""
COUNTS = (
    Column("iterations", "iterations", cost=True),
    Column("linear_iterations", "CG iterations", cost=True),
)


def time_solve(
    make: Callable[[], Scene], tolerance: float, *, start: Floats | None = None, **how
) -> tuple[Solution, dict]:
    """Make, prepare and solve a scene, by `how` as `prepare` takes it; the solution, and the values of the columns."""
    marks = [time.process_time()]
    scene = make()
    marks.append(time.process_time())
    prepared = prepare(scene, **how)
    marks.append(time.process_time())
    solution = prepared.solve(tolerance=tolerance, start=start)
    marks.append(time.process_time())
    times = dict(zip(("scene_s", "prepare_s", "solve_s"), np.diff(marks).tolist(), strict=True))
    return solution, {**times, "cpu_s": marks[-1] - marks[0], **count_work(solution)}


def count_work(solution: Solution) -> dict:
    """Count how often a solver and its linear solver iterated, and say why it ended."""
    return {
        "iterations": solution.iterations,
        "linear_iterations": solution.detail.get("linear_iterations"),
        "converged": solution.is_balanced,
        "reason": solution.reason.name,
    }


def count_unfinished(rows: Sequence[Values]) -> int:
    """Count the solves of the rows' values that did not reach what was asked."""
    return sum(not values["converged"] for values in rows)


def load_kernels(law: FaceLaw = PD_ENERGY, **how) -> None:
    """Solve a scene of one tet, which compiles what is compiled when it is first called, or reads it from the disk."""
    vertices = np.vstack([np.zeros(3), np.eye(3)])
    ids = np.arange(4)
    parts = (
        terms.Strain(1.0),
        terms.Volume(1.0),
        terms.SurfaceStrain(np.array([[1, 2, 3]]), 1.0),
        terms.Target(ids, 1.1 * vertices, 1.0),
    )
    prepare(apply_law(Scene(vertices, np.array([[0, 1, 2, 3]]), parts), law), **how).solve()
