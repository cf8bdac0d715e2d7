"""V3 and H11: steps of implicit Euler, which has closed forms for free fall and for an oscillator.

A block of tissue falls and swings as a whole, so that its elastic energies must stay out of it. Units: mm, s, kPa.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats
from ..march import march
from ..scene import Scene
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


def _march(attempt: Attempt, scene: Scene, time_step: float, steps: int, **course) -> Floats:
    """March by implicit Euler on the attempt's solver: positions [mm], shape (steps + 1, n, 3)."""
    run = march(scene, time_step=time_step, steps=steps, density=DENSITY, solver=attempt.solver, **course)
    attempt.iterations += int(run.iterations.sum())
    if not run.converged:
        attempt.stopped = run.reason
    return run.positions


def free_fall_error(attempt: Attempt) -> float:
    """The largest distance from z_n = -g h² n (n + 1)/2, relative to the depth fallen."""
    h = 1.0 / 60.0
    X, tets = box(CELLS, SIZE)
    scene = Scene(X, tets, (*TISSUE, Gravity(GRAVITY * DOWN, DENSITY)))
    fallen = _march(attempt, scene, h, STEPS, tolerance=1e-10) - X
    n = np.arange(STEPS + 1)
    depth = GRAVITY * h**2 * n * (n + 1) / 2
    return float(np.abs(fallen - depth[:, None, None] * DOWN).max() / depth[-1])


def _masses(scene: Scene) -> Floats:
    """The mass [kg] that vertices have, shape (n,)."""
    weight = Gravity(DOWN, DENSITY)
    return replace(scene, terms=(weight,)).loads() @ DOWN


def oscillator_error(part: str, attempt: Attempt) -> float:
    """Relative error of the "amplitude" ratio 1/√(1 + (ωh)²) per step or of the "angle" atan(ωh) per step.

    Springs of ω² times each vertex' mass swing the block as one. A swing obeys x_n+1 = 2 r cos(a) x_n - r² x_n-1.
    """
    h, omega = 1.0 / 60.0, 2.0 * np.pi * FREQUENCY
    X, tets = box(CELLS, SIZE)
    tissue = Scene(X, tets, TISSUE)
    scene = replace(tissue, terms=(*TISSUE, Target(np.arange(len(X)), X, omega**2 * _masses(tissue))))
    first = np.tile([100.0, 0.0, 0.0], (len(X), 1))
    x = (_march(attempt, scene, h, STEPS, velocities=first, tolerance=1e-12) - X).mean(axis=1)[1:, 0]
    (last, before), *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:], rcond=None)
    ratio = np.sqrt(-before)
    value, expected = {
        "amplitude": (ratio, 1.0 / np.sqrt(1.0 + (omega * h) ** 2)),
        "angle": (np.arccos(last / (2.0 * ratio)), np.arctan(omega * h)),
    }[part]
    return abs(value / expected - 1.0)


def standing() -> Scene:
    """A column that stands on its base under its own weight."""
    X, tets = box(CELLS, SIZE)
    return Scene(X, tets, (*TISSUE, Gravity(GRAVITY * DOWN, DENSITY), Fixed(vertices_at(X, 2, 0.0))))


def largest_rise(time_step: float, attempt: Attempt) -> float:
    """The largest rise of the energy from one iteration of the first step to the next, relative to what it falls by."""
    scene = standing()
    step = Target(np.arange(len(scene.vertices)), scene.vertices, _masses(scene) / time_step**2)
    posed = replace(scene, terms=(*scene.terms, step))
    energy = attempt.solve(attempt.prepare(posed), tolerance=1e-10).history.energy
    return float(np.diff(energy).max(initial=0.0) / (energy[0] - energy[-1]))


def distance_to_static(time_step: float, attempt: Attempt) -> float:
    """The largest distance of one step's end from the static answer, relative to the largest displacement."""
    scene = standing()
    rest = attempt.solve(attempt.prepare(scene), tolerance=1e-12).positions
    end = _march(attempt, scene, time_step, 1, tolerance=1e-12)[-1]
    return float(np.abs(end - rest).max() / np.abs(rest - scene.vertices).max())


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
