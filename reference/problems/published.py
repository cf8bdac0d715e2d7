"""A problem of literature without a closed form: a block under partial pressure; values on refined meshes.

The nearly incompressible block of Reese, Wriggers and Reddy 2000, a quarter of it by symmetry, is set up as in
deal.II's step-44: a unit cube, its top held in its plane and loaded on a quarter. Stresses in MPa.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import Volumetric
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Traction
from .cook import law
from .homogeneous import rollers
from .meshes import block, positive, triangles_at, vertices_at
from .problem import Problem, mixed_problem

BLOCK_SOURCE = "set-up: deal.II step-44 after Reese, Wriggers and Reddy 2000; value computed on refined meshes"
COMPRESSION = {20: 21.98, 40: 42.50, 60: 58.55}
"""Percent at the middle of the loaded face, by the load p/p0."""


def graded_block(cells: int) -> tuple[Floats, Ints]:
    """The unit cube with cells that are lower towards its top, their diagonals falling away from the loaded corner."""
    X, tets = block(cells)
    X = X * 1.0
    X[:, 1] = 1.0 - X[:, 1] ** 2
    return X, positive(X, tets)


def pressed(load: float, cells: int) -> Scene:
    """The block under a dead pressure of 4 p/p0 MPa on x, z < 1/2 of its top; `cells` per side must be even."""
    X, tets = graded_block(cells)
    top = triangles_at(X, tets, 1, 1.0)
    loaded = top[(X[top][:, :, [0, 2]] <= 0.5 + 1e-9).all(axis=(1, 2))]
    return Scene(
        X,
        tets,
        (
            Hyperelastic(law(80.194, 0.4999, Volumetric.LOGARITHMIC)),
            *rollers(X),
            Fixed(vertices_at(X, 1, 1.0), components=(0, 2)),
            Traction(loaded, np.array([0.0, -4.0 * load, 0.0])),
        ),
    )


def compression(scene: Scene, solution: Solution) -> float:
    """How far the point (0, 1, 0) has sunk, in percent of the height."""
    corner = np.argmin(np.linalg.norm(scene.vertices - [0.0, 1.0, 0.0], axis=1))
    return 100.0 * float(1.0 - solution.positions[corner, 1])


def _blocks(sizes: tuple[int, ...]) -> tuple[Problem, ...]:
    return tuple(
        mixed_problem(
            f"block under partial pressure, p/p0={load}, P2P1, {n} cells: percent",
            BLOCK_SOURCE,
            partial(pressed, load, n),
            compression,
            value,
            {"fenicsx": 1e-2},
        )
        for n in sizes
        for load, value in COMPRESSION.items()
    )


BLOCKS = _blocks((4, 6))
FINE_BLOCKS = _blocks((8,))

PROBLEMS = BLOCKS
FINE = FINE_BLOCKS
