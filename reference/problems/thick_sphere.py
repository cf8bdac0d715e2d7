"""A thick incompressible neo-Hookean sphere under internal pressure, an eighth of it by symmetry.

P = mu (2/b + 1/(2 b⁴) - 2/a - 1/(2 a⁴)), a and b the stretches of the inner and the outer surface, which volume ties
(Ogden 1984, "Non-linear Elastic Deformations", Section 5.3.2). P has a maximum, a limit point under pressure control.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import Incompressible, NeoHookean
from ..scene import Scene
from ..solution import Reason, Solution
from ..terms import Fixed, Hyperelastic, Pressure
from .meshes import boundary_triangles, positive, vertices_at
from .problem import Problem

SOURCE = "closed form: Ogden 1984, Section 5.3.2"
INNER, OUTER = 1.0, 2.0
PRESSURE_AT_HALF = 0.7554331187
"""P/mu where the inner radius has grown by a half."""
LIMIT_STRETCH, LIMIT_PRESSURE = 1.82822, 0.8164236


def octant(cells: int, layers: int) -> tuple[Floats, Ints]:
    """An eighth of the shell [mm]: a face of the octahedron in cells² triangles, times layers of prisms.

    A prism's tets take its vertices by their order in the triangulation, so that neighbours share their diagonals.
    """
    corners = [(i, j) for i in range(cells + 1) for j in range(cells + 1 - i)]
    number = {corner: at for at, corner in enumerate(corners)}
    flat = np.array([(i, j, cells - i - j) for i, j in corners], dtype=np.float64)
    turned = np.tan(np.pi / 4 * flat / cells)  # even angles along the edges
    unit = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    triangles = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in corners if i + j < cells]
    triangles += [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in corners if i + j < cells - 1]
    base = np.sort(np.array(triangles), axis=1)
    radii = INNER * (OUTER / INNER) ** (np.arange(layers + 1) / layers)
    X = (radii[:, None, None] * unit).reshape(-1, 3)
    n, tets = len(unit), []
    for layer in range(layers):
        low, high = base + layer * n, base + (layer + 1) * n
        for upper in range(3):
            tets.append(np.concatenate([low[:, : upper + 1], high[:, upper:]], axis=1))
    return X, positive(X, np.concatenate(tets))


def sphere(pressure: float, cells: int, layers: int) -> Scene:
    """The octant of shear modulus 1 kPa under an internal pressure [kPa]."""
    X, tets = octant(cells, layers)
    triangles = boundary_triangles(tets)
    inner = triangles[np.isclose(np.linalg.norm(X[triangles], axis=2), INNER).all(axis=1)]
    return Scene(
        X,
        tets,
        (
            Hyperelastic(Incompressible(NeoHookean(1.0, 1.0))),
            *(Fixed(vertices_at(X, axis, 0.0), components=(axis,)) for axis in range(3)),
            Pressure(inner, pressure),
        ),
    )


def stretch(scene: Scene, solution: Solution) -> float:
    """The mean stretch of the inner surface's vertices."""
    inner = np.isclose(np.linalg.norm(scene.vertices, axis=1), INNER)
    return float(np.linalg.norm(solution.positions[inner], axis=1).mean() / INNER)


def load_reached(scene: Scene, solution: Solution) -> float:
    """The pressure [kPa] of the last equilibrium."""
    (pressure,) = scene.of(Pressure)
    return float(pressure.value) * solution.detail["load_share"]


def _problems(
    sizes: tuple[tuple[int, int], ...], bounds: tuple[float, ...], limited: tuple[int, int]
) -> tuple[Problem, ...]:
    inflated = [
        Problem(
            f"thick sphere, P/mu=.755, P2P1, {n}x{layers} cells: inner stretch",
            SOURCE,
            partial(sphere, PRESSURE_AT_HALF, n, layers),
            stretch,
            1.5,
            {"fenicsx": bound},
            options={"element": "P2P1"},
            tolerance=1e-9,
        )
        for (n, layers), bound in zip(sizes, bounds, strict=True)
    ]
    beyond = Problem(
        f"thick sphere, P/mu=.83, P2P1, {limited[0]}x{limited[1]} cells: limit point",
        SOURCE,
        partial(sphere, 0.83, *limited),
        load_reached,
        LIMIT_PRESSURE,
        {"fenicsx": 1e-2},
        options={"element": "P2P1"},
        tolerance=1e-9,
        reason=Reason.LIMIT_POINT,
    )
    return (*inflated, beyond)


# The flat faces' error of the radius is of second order in the cells.
PROBLEMS = _problems(((4, 3), (6, 4)), (0.02, 0.01), (4, 3))
FINE = _problems(((10, 6),), (0.004,), (6, 4))
