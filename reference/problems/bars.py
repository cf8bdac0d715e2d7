"""Bars of projective dynamics' strain energy, whose lateral stretch is 1: elongations in closed form."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Gravity, Strain, Term, Traction
from .meshes import box, triangles_at, vertices_at
from .problem import Problem

CELLS = (8, 2, 2)
RATIOS = (1.0, 1e2, 1e4, 1e6)


def _lateral_rollers(X: Floats) -> Fixed:
    """Every vertex moves along the bar only."""
    return Fixed(np.arange(len(X)), components=(1, 2))


def self_weight() -> Scene:
    """A bar of length 1 m, density 1000 kg/m³ and stiffness 1e5 Pa in 9.81 m/s², hanging from x = 0 (SI units).

    The load of a section's vertices differs, so the section warps a little: the mean is exact but for the square of
    that warp, which finer cells along the bar make small.
    """
    X, tets = box((2 * CELLS[0], *CELLS[1:]), (1.0, 0.25, 0.25))
    terms: tuple[Term, ...] = (
        Strain(1e5),
        Gravity(np.array([9.81, 0.0, 0.0]), density=1000.0),
        Fixed(vertices_at(X, 0, 0.0), components=(0,)),
        _lateral_rollers(X),
    )
    return Scene(X, tets, terms)


def layers(ratio: float) -> Scene:
    """A bar of two halves, the second `ratio` times as stiff as the first, under a tenth of the first's stiffness."""
    X, tets = box(CELLS, (1.0, 0.25, 0.25))
    first = X[tets, 0].mean(axis=1) < 0.5
    terms: tuple[Term, ...] = (
        Strain(np.where(first, 1.0, ratio)),
        Traction(triangles_at(X, tets, 0, 1.0), np.array([0.1, 0.0, 0.0])),
        Fixed(vertices_at(X, 0, 0.0), components=(0,)),
        _lateral_rollers(X),
    )
    return Scene(X, tets, terms)


def tip(scene: Scene, solution: Solution) -> float:
    """The mean displacement over the area of the face x = 1, along x."""
    triangles = triangles_at(scene.vertices, scene.tets, 0, 1.0)
    corners = scene.vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    moved = (solution.positions - scene.vertices)[triangles, 0].mean(axis=1)
    return float(areas @ moved / areas.sum())


def _problems() -> list[Problem]:
    bounds = {"projective": 1e-6, "fenicsx": 1e-6, "skfem": 1e-6}
    weight = Problem(
        "bar under its own weight",
        "closed form: tip = rho g L²/(2 ws)",
        self_weight,
        tip,
        1000.0 * 9.81 / (2 * 1e5),
        bounds,
    )
    series = [
        Problem(
            f"two layers in series, 1:{ratio:g}",
            "closed form: F/A (L1/w1 + L2/w2)",
            partial(layers, ratio),
            tip,
            0.1 * (0.5 + 0.5 / ratio),
            bounds,
        )
        for ratio in RATIOS
    ]
    return [weight, *series]


PROBLEMS = tuple(_problems())
