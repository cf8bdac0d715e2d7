"""The way from rest to a deep overlap, with contact met on the way: then nothing has gone through, out at the back.

The energy is replaced by its PD matrix A around the solution without contact, so that contact alone is solved for: with
û the displacement without contact at a share of the way and g its gaps, the forces f >= 0 minimise the dual
½ fᵀ (C A⁻¹ Cᵀ + 1/stiffness) f + gᵀ f, and the displacement is û + A⁻¹ Cᵀ f.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numba import njit

from ....lhm.base.mesh import Floats, Ints
from ..coordinates import Place
from .compliance import Elasticity
from .detection import Detection
from .rows import Rows

STEP = 1.0
"""The way [mm] that no vertex of the surface goes further than between two looks for contact."""
LOOKS = 3
"""Rounds of looking and pushing at one place at most."""
NEARLY = 0.1
"""The depth [mm] with which the way goes on."""
SWEEPS = 200
"""Gauss-Seidel sweeps at most; the descent that follows makes up for what they leave."""


@njit(cache=True)
def _dual(matrix, gaps, forces):
    """Projected Gauss-Seidel on the dual, from `forces` on, in place."""
    for _ in range(SWEEPS):
        change = 0.0
        for i in range(len(gaps)):
            slope = gaps[i]
            for j in range(len(gaps)):
                slope += matrix[i, j] * forces[j]
            force = max(forces[i] - slope / matrix[i, i], 0.0)
            change = max(change, abs(force - forces[i]) * matrix[i, i])
            forces[i] = force
        if change < 1e-4:
            break


def approached(
    elasticity: Elasticity, detect: Callable[[Floats, Rows | None], Detection], rest: Floats, end: Place, vertices: Ints
) -> tuple[Place, Detection]:
    """A place like `end` that is not overlapped as deeply, and the contact there, with its forces for multipliers.

    rest [mm], shape (n, 3); vertices (k,) are those of the surfaces.
    """
    moved = end.u[vertices]
    steps = max(1, int(np.ceil(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max() / STEP)))
    coordinates = elasticity.system.coordinates
    place = force_free = coordinates.start(0.0 * end.u)
    found = detect(rest + place.u, None)
    for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
        ahead = coordinates.start(share * end.u)
        # Where contact pushed so far is a better place to look than where nothing did.
        place = coordinates.start(place.u + ahead.u - force_free.u)
        force_free = ahead
        for _ in range(LOOKS):
            found = detect(rest + place.u, found.rows)
            place, found = _pushed(elasticity, rest, force_free, found)
            if found.depth <= NEARLY:
                break
    return place, found


def _pushed(elasticity: Elasticity, rest: Floats, force_free: Place, found: Detection) -> tuple[Place, Detection]:
    rows = found.rows
    if not len(rows.ids):
        return force_free, found
    gradients, compliance = elasticity.of(rows, force_free)
    forces = rows.multipliers.copy()
    _dual(compliance + np.diag(1.0 / rows.stiffness), rows.gaps(rest + force_free.u), forces)
    step = elasticity.system.solve(gradients.T @ forces, force_free.rotations)
    place = elasticity.system.coordinates.move(force_free, step)
    return place, replace(found, rows=replace(rows, multipliers=forces))
