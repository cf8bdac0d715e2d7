"""V3 and H11: steps of implicit Euler, which has closed forms for free fall and for an oscillator.

A block of tissue falls and swings as a whole, so that its elastic energies must stay out of it. Units: mm, s, kPa.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats
from ..march import march
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Gravity, Strain, Target, Term, Volume
from .meshes import box, vertices_at
from .problem import EVERY_SOLVER, Attempt, HardCase

DENSITY = 1e-6
GRAVITY = 9810.0
SIZE, CELLS = (10.0, 10.0, 20.0), (2, 2, 4)
TISSUE: tuple[Term, ...] = (Strain(5.0), Volume(67.5))
STEPS = 20
FREQUENCY = 4.0
DOWN = np.array([0.0, 0.0, -1.0])


def _march(
    scene: Scene, attempt: Attempt, time_step: float, steps: int, first: Floats | None = None, tolerance: float = 1e-10
) -> list[Solution]:
    """March from rest, with velocities `first` [mm/s], shape (n, 3); return the steps' solutions."""
    start, *moments = march(
        scene, time_step=time_step, steps=steps, solver=attempt.solver, density=DENSITY, velocities=first,
        tolerance=tolerance, **attempt.options,
    )  # fmt: skip
    for moment in moments:
        attempt.count(moment.solution)
    return [moment.solution for moment in moments]


def free_fall_error(attempt: Attempt) -> float:
    """The largest distance from z_n = -g h² n (n + 1)/2, relative to the depth fallen."""
    h = 1.0 / 60.0
    X, tets = box(CELLS, SIZE)
    scene = Scene(X, tets, (*TISSUE, Gravity(GRAVITY * DOWN, DENSITY)))
    fallen = np.stack([s.positions for s in _march(scene, attempt, h, STEPS)]) - X
    n = np.arange(1, STEPS + 1)
    depth = GRAVITY * h**2 * n * (n + 1) / 2
    return float(np.abs(fallen - depth[:, None, None] * DOWN).max() / depth[-1])


def oscillator_error(part: str, attempt: Attempt) -> float:
    """Relative error of the "amplitude" ratio 1/√(1 + (ωh)²) per step or of the "angle" atan(ωh) per step.

    Springs of ω² times each vertex' mass swing the block as one. A swing obeys x_n+1 = 2 r cos(a) x_n - r² x_n-1.
    """
    h, omega = 1.0 / 60.0, 2.0 * np.pi * FREQUENCY
    X, tets = box(CELLS, SIZE)
    masses = Gravity(DOWN, DENSITY).lump(Scene(X, tets, TISSUE), DENSITY)
    scene = Scene(X, tets, (*TISSUE, Target(np.arange(len(X)), X, omega**2 * masses)))
    first = np.tile([100.0, 0.0, 0.0], (len(X), 1))
    x = np.array([np.mean(s.positions - X, axis=0)[0] for s in _march(scene, attempt, h, STEPS, first, 1e-12)])
    (last, before), *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:], rcond=None)
    ratio = np.sqrt(-before)
    value, expected = {
        "amplitude": (ratio, 1.0 / np.sqrt(1.0 + (omega * h) ** 2)),
        "angle": (np.arccos(last / (2.0 * ratio)), np.arctan(omega * h)),
    }[part]
    return abs(value / expected - 1.0)


def hanging() -> Scene:
    """A column that stands on its base and is let go under its own weight."""
    X, tets = box(CELLS, SIZE)
    return Scene(X, tets, (*TISSUE, Gravity(GRAVITY * DOWN, DENSITY), Fixed(vertices_at(X, 2, 0.0))))


def largest_rise(time_step: float, attempt: Attempt) -> float:
    """The largest rise of the energy from one iteration to the next, relative to the most that a step lowers it by."""
    histories = [s.history.energy for s in _march(hanging(), attempt, time_step, 3)]
    rise = max(np.diff(energy).max(initial=0.0) for energy in histories)
    return float(rise / max(energy[0] - energy[-1] for energy in histories))


def distance_to_static(time_step: float, attempt: Attempt) -> float:
    """The largest distance of one step's end from the static answer, relative to the largest displacement."""
    scene = hanging()
    static = attempt.solve(attempt.prepare(scene), tolerance=1e-12).positions
    (step,) = _march(scene, attempt, time_step, 1, tolerance=1e-12)
    return float(np.abs(step.positions - static).max() / np.abs(static - scene.vertices).max())


CASES = (
    HardCase(
        "free fall by implicit Euler",
        "V3; closed form: -g h² n (n + 1)/2",
        "positions within 1e-9 of the depth fallen",
        free_fall_error,
        1e-9,
        EVERY_SOLVER,
    ),
    *(
        HardCase(
            f"oscillator by implicit Euler: {part} per step",
            "V3; closed form: 1/√(1 + (ωh)²), atan(ωh)",
            "ratio within 1e-9",
            partial(oscillator_error, part),
            1e-9,
            EVERY_SOLVER,
        )
        for part in ("amplitude", "angle")
    ),
    *(
        HardCase(
            f"time step of {h:.4g} s",
            "H11",
            "the energy falls from iteration to iteration, but for rounding",
            partial(largest_rise, h),
            1e-12,
            EVERY_SOLVER,
        )
        for h in (1 / 240, 1 / 60, 0.1, 1.0, 10.0, 1000.0)
    ),
    HardCase(
        "time step of 1000 s: static",
        "H11; the static answer",
        "positions within 1e-6 of the largest displacement",
        partial(distance_to_static, 1000.0),
        1e-6,
        EVERY_SOLVER,
    ),
)
