"""Moving held vertices to their places without crushing the elements next to them."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from .definite import solve_semidefinite
from .energy import Energy
from .newton import Scales, minimise
from .unknowns import Unknowns

SMALLEST_PART = 1 / 64
# Between two parts of a motion the free vertices need to follow only roughly.
RELAXED = 1e-2
RELAXING_ITERATIONS = 20


def carry(
    energy: Energy, x: Floats, goal: Floats, *, held: Ints, free: Ints, scales: Scales
) -> tuple[Floats, float] | None:
    """Move the held degrees of freedom from x, where the energy is finite, to `goal` [mm], shape (size,).

    The free ones follow as the body linearised at x would. Where the energy is not finite after the whole motion, the
    largest of its halves, quarters, ... that keeps it finite is made first; the free vertices relax before the next.
    Returns positions of finite energy and the norm [mN] of the forces that the motion causes while nothing follows;
    None if there is no such way.
    """
    forces = 0.0
    while True:
        jump = goal[held] - x[held]
        if not jump.any():
            return x, forces
        matrix = energy.projected_hessian(x)[free]
        load = matrix[:, held] @ jump
        forces = max(forces, float(np.linalg.norm(load)))
        following = solve_semidefinite(matrix[:, free], -load, scale=scales.stiffness)
        if following is None:
            return None
        whole = goal.copy()
        whole[free] = x[free] + following
        part = _largest_finite_part(energy, x, whole)
        if part == 1.0:
            return whole, forces
        if part == 0.0:
            return None
        x, _, _ = minimise(
            energy,
            x + part * (whole - x),
            Unknowns(free, len(x), []),
            scales=scales,
            threshold=lambda first: RELAXED * first,
            max_iterations=RELAXING_ITERATIONS,
            on_step=lambda x, value, norm: False,
        )


def _largest_finite_part(energy: Energy, x: Floats, whole: Floats) -> float:
    """1, 1/2, 1/4, ...: the largest part of the motion from x that leaves the energy finite; 0 if it is too small."""
    part = 1.0
    while part >= SMALLEST_PART:
        if np.isfinite(energy.value(x + part * (whole - x) if part < 1 else whole)):
            return part
        part /= 2
    return 0.0
