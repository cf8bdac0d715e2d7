"""libigl: as rigid as possible, local and global steps; it takes no load, and its rotations are float32."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock

TITLE = "libigl ARAP"
PACKAGES = ("libigl==2.6.3",)
LAW = "as rigid as possible"
DTYPE = "float64, rotations float32"
TOLERANCE = float("inf")
SETTINGS: Mapping[str, Mapping[str, Any]] = {"elements (default)": {}}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """Do one local and global step per call until the budget is spent."""
    import igl

    clock.end("imports")
    problem.one_material()
    if problem.forces.any():
        problem.refuse("it takes no load")
    data = igl.ARAPData()
    data.max_iter = 1
    data.energy = igl.ARAPEnergyType.ARAP_ENERGY_TYPE_ELEMENTS
    held, order = np.unique(problem.held, return_index=True)
    igl.arap_precomputation(problem.vertices, problem.tets.astype(np.int64), 3, held.astype(np.int32), data)
    clock.end("set-up")
    x = np.array(problem.start)
    x[held] = problem.places[order]
    step, going = 0, clock.see(x, 0)
    while going:
        ahead = igl.arap_solve(problem.places[order], data, x)
        step += 1
        still = np.abs(ahead - x).max() < 1e-9
        x = ahead
        going = clock.see(x, step) and not still
