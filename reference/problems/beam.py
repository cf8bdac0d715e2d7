"""The deformation of a beam, problem 1 of Land et al. 2015, "Verification of cardiac mechanics software"."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import Guccione, Incompressible
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Pressure
from .meshes import box, triangles_at, vertices_at
from .problem import Problem

SOURCE = "set-up: Land et al. 2015, problem 1 (published codes 4.0-4.2 mm); value computed on refined meshes"


def graded(cells: tuple[int, int, int]) -> tuple[Floats, Ints]:
    """The bar with shorter cells towards its clamp, whose edges are singular, and thinner ones towards its sides."""
    X, tets = box(cells)
    across = (1.0 - np.cos(np.pi * X[:, 1:])) / 2.0
    return np.column_stack([10.0 * X[:, 0] ** 1.8, across]), tets


def beam(cells: tuple[int, int, int]) -> Scene:
    """A bar of 10 x 1 x 1 mm, its fibres along it, clamped at x = 0, follower pressure .004 kPa under it."""
    X, tets = graded(cells)
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


def tip(scene: Scene, solution: Solution) -> float:
    """The deformed height [mm] of the point (10, .5, 1)."""
    end = np.argmin(np.linalg.norm(scene.vertices - [10.0, 0.5, 1.0], axis=1))
    return float(solution.positions[end, 2])


def _problems(sizes: tuple[tuple[int, int, int], ...]) -> tuple[Problem, ...]:
    return tuple(
        Problem(
            f"beam of Land et al., P2P1, {'x'.join(map(str, cells))} cells: height of the tip",
            SOURCE,
            partial(beam, cells),
            tip,
            4.169,
            {"fenicsx": 5e-3},
            options={"element": "P2P1"},
            tolerance=1e-9,
        )
        for cells in sizes
    )


PROBLEMS = _problems(((10, 2, 2), (10, 2, 4)))
FINE = _problems(((16, 4, 4),))
