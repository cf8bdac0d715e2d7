"""libigl's as-rigid-as-possible solver on tets, beside ours on the same energy.

libigl (PyPI `libigl`) is under the MPL-2; its parts under the GPL (`igl.copyleft`) are not used. It is optional.
"""

from __future__ import annotations

import importlib.util
import os
import time
from dataclasses import dataclass

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ....lhm.head.head import LayeredHead
from ....reference import Scene, terms
from ..measures import Trace, largest_distance

EVERY = 16
"""Of the skin wrap's vertices, one in so many is a handle, as markers of motion capture are."""
MAX_ITERATIONS = 120
STILL = 5e-5
"""[mm] largest step of a vertex below which libigl has converged; its rotations are fitted in float32."""


def is_installed() -> bool:
    """Say whether libigl is there."""
    return importlib.util.find_spec("igl") is not None


@dataclass(frozen=True, eq=False)
class Handles:
    """Vertices (k,) that are put at positions (k, 3) [mm]."""

    vertices: Ints
    positions: Floats

    @classmethod
    def of(cls, head: LayeredHead, scene: Scene, targets: Floats) -> Handles:
        """Take what a facial scene holds, and every sixteenth vertex of the skin wrap at its target [mm], (skin, 3)."""
        held, positions = scene.dirichlet()
        marks = np.arange(0, len(head.bone), EVERY)
        positions[marks] = head.wrap_targets(targets)[marks]
        vertices = np.union1d(np.flatnonzero(held.all(axis=1)), marks)
        return cls(vertices, positions[vertices])

    def scene(self, scene: Scene) -> Scene:
        """Give the tets of a scene libigl's energy of elements up to its factor, Σ V ‖F - R‖², and the handles."""
        return Scene(scene.vertices, scene.tets, (terms.Strain(2.0), terms.Fixed(self.vertices, self.positions)))


def solve_by_igl(scene: Scene, handles: Handles, truth: Floats) -> tuple[Floats, float, Trace, Floats]:
    """Find the answer of libigl [mm], its preparation [s], its errors to the truth [mm], and those to its own answer.

    One local and global step per call, on one thread; what a call costs beside that (copies of the arrays) is counted,
    and small.
    """
    os.environ.setdefault("IGL_NUM_THREADS", "1")
    import igl

    data = igl.ARAPData()
    data.max_iter = 1
    data.energy = igl.ARAPEnergyType.ARAP_ENERGY_TYPE_ELEMENTS
    begin = time.perf_counter()
    igl.arap_precomputation(scene.vertices, scene.tets.astype(np.int64), 3, handles.vertices.astype(np.int32), data)
    prepared = time.perf_counter() - begin
    x, spent = np.array(scene.vertices), 0.0
    x[handles.vertices] = handles.positions
    visited, seconds = [x], [0.0]
    while len(visited) <= MAX_ITERATIONS:
        begin = time.perf_counter()
        ahead = igl.arap_solve(handles.positions, data, x)
        spent += time.perf_counter() - begin
        visited.append(ahead)
        seconds.append(spent)
        if largest_distance(ahead, x) <= STILL:
            break
        x = ahead
    error = [largest_distance(v, truth) for v in visited]
    own = [largest_distance(v, visited[-1]) for v in visited]
    return visited[-1], prepared, Trace(seconds, error, [1.0] * len(seconds)), np.array(own)
