"""Cook's membrane in three dimensions: a tapered panel, clamped on the left and sheared on the right, in plane strain.

The compressible panel is that of Miehe 1994 and deal.II's code gallery ("Quasi-static finite-strain compressible
elasticity"), the nearly incompressible one is its variant at a Poisson's ratio of .4999. Stresses in MPa.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import IsochoricNeoHookean, Volumetric
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Traction
from .meshes import box, triangles_at, vertices_at
from .problem import Problem, mixed_problem

WIDTH, LEFT, RIGHT = 48.0, 44.0, 16.0
MIDDLE, CORNER = (48.0, 52.0), (48.0, 60.0)
GRADING = 1.6  # of the cells towards the clamped edge, whose upper end is a singular point
COMPRESSIBLE_SOURCE = "published: Miehe 1994; deal.II code gallery, quadratic hexahedra refined to 14.74 mm"
INCOMPRESSIBLE_SOURCE = "computed: a code that reproduces the published tables of Cook's membrane to all digits"


def panel(cells: int) -> tuple[Floats, Ints]:
    """The panel [mm] in cells² cells of one layer, graded towards the clamped edge and the free edges."""
    X, tets = box((cells, cells, 1))
    s = X[:, 0] ** GRADING
    t = (1.0 - np.cos(np.pi * X[:, 1])) / 2.0
    return np.stack([WIDTH * s, LEFT * s + t * (LEFT + (RIGHT - LEFT) * s), X[:, 2]], axis=1), tets


def law(mu: float, poisson: float, volumetric: Volumetric) -> IsochoricNeoHookean:
    """The law of shear modulus mu at a Poisson's ratio."""
    return IsochoricNeoHookean(mu, 2 * mu * (1 + poisson) / (3 * (1 - 2 * poisson)), volumetric)


def cook(material: IsochoricNeoHookean, traction: float, cells: int) -> Scene:
    """The panel under a dead shear traction on its right edge."""
    X, tets = panel(cells)
    return Scene(
        X,
        tets,
        (
            Hyperelastic(material),
            Fixed(vertices_at(X, 0, 0.0), components=(0, 1)),
            Fixed(np.arange(len(X)), components=(2,)),
            Traction(triangles_at(X, tets, 0, WIDTH), np.array([0.0, traction, 0.0])),
        ),
    )


def rise(at: tuple[float, float], scene: Scene, solution: Solution) -> float:
    """The vertical displacement [mm] of the point (x, y), the mean through the thickness."""
    near = np.isclose(scene.vertices[:, :2], at).all(axis=1)
    return float((solution.positions - scene.vertices)[near, 1].mean())


def _problems(sizes: tuple[int, ...], nearly: tuple[int, ...]) -> tuple[Problem, ...]:
    middle, corner = partial(rise, MIDDLE), partial(rise, CORNER)
    stout = [
        Problem(
            f"Cook's membrane, nu=.3, P2, {n} cells: middle of the edge",
            COMPRESSIBLE_SOURCE,
            partial(compressible, n),
            middle,
            14.74,
            {"fenicsx": 2e-3},
            options={"element": "P2"},
            tolerance=1e-9,
        )
        for n in sizes
    ]
    soft = [
        mixed_problem(
            f"Cook's membrane, nu=.4999, P2P1, {n} cells: {name}",
            INCOMPRESSIBLE_SOURCE,
            partial(incompressible, n),
            quantity,
            value,
            {"fenicsx": 3e-3},
        )
        for n in nearly
        for name, quantity, value in (("corner", corner, 6.931), ("middle of the edge", middle, 6.952))
    ]
    return (*stout, *soft)


compressible = partial(cook, law(0.4225, 0.3, Volumetric.LOGARITHMIC), 1 / 16)
incompressible = partial(cook, law(80.194, 0.4999, Volumetric.QUADRATIC), 6.25)
PROBLEMS = _problems((8, 12), (16,))
FINE = _problems((16,), (20, 24))
