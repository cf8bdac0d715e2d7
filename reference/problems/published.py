"""Problems of literature without a closed form: a block under partial pressure, and a beam; values on refined meshes.

The nearly incompressible block of Reese, Wriggers and Reddy 2000, a quarter of it by symmetry, is set up as in
deal.II's step-44: a unit cube, its top held in its plane and loaded on a quarter. Stresses in MPa.
The beam is problem 1 of Land et al. 2015, "Verification of cardiac mechanics software".
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import Guccione, Incompressible, Volumetric
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Pressure, Traction
from .cook import law
from .homogeneous import rollers
from .meshes import block, box, positive, triangles_at, vertices_at
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


BEAM_SOURCE = "set-up: Land et al. 2015, problem 1 (published codes 4.0-4.2 mm); value computed on refined meshes"


def graded_bar(cells: tuple[int, int, int]) -> tuple[Floats, Ints]:
    """The bar with shorter cells towards its clamp, whose edges are singular, and thinner ones towards its sides."""
    X, tets = box(cells)
    across = (1.0 - np.cos(np.pi * X[:, 1:])) / 2.0
    return np.column_stack([10.0 * X[:, 0] ** 1.8, across]), tets


def clamped_beam(cells: tuple[int, int, int]) -> Scene:
    """A bar of 10 x 1 x 1 mm, its fibres along it, clamped at x = 0, follower pressure .004 kPa under it."""
    X, tets = graded_bar(cells)
    fibres = np.array([1.0, 0.0, 0.0])
    return Scene(
        X,
        tets,
        (
            Hyperelastic(Incompressible(Guccione(2.0, 8.0, 2.0, 4.0, fibres))),
            Fixed(vertices_at(X, 0, 0.0)),
            Pressure(triangles_at(X, tets, 2, 0.0), 0.004),
        ),
    )


def tip_height(scene: Scene, solution: Solution) -> float:
    """The deformed height [mm] of the point (10, .5, 1)."""
    end = np.argmin(np.linalg.norm(scene.vertices - [10.0, 0.5, 1.0], axis=1))
    return float(solution.positions[end, 2])


def _beams(sizes: tuple[tuple[int, int, int], ...]) -> tuple[Problem, ...]:
    return tuple(
        mixed_problem(
            f"beam of Land et al., P2P1, {'x'.join(map(str, cells))} cells: height of the tip",
            BEAM_SOURCE,
            partial(clamped_beam, cells),
            tip_height,
            4.169,
            {"fenicsx": 5e-3},
        )
        for cells in sizes
    )


BEAMS = _beams(((10, 2, 2), (10, 2, 4)))
FINE_BEAMS = _beams(((16, 4, 4),))

PROBLEMS = (*BLOCKS, *BEAMS)
FINE = (*FINE_BLOCKS, *FINE_BEAMS)
