"""A cylinder of an incompressible law, twisted and stretched (Rivlin 1949): the energy, whose derivatives are loads.

By a turn of p per length and a stretch l, R goes to R/√l and I1 to l² + 2/l + p² R²/l, I2 to 2 l + 1/l² + p² R²/l².
The derivative of the energy by the turn is the torque, and by the stretch the axial force: Poynting's effect, for at
l = 1 it is a thrust, which vanishes for the neo-Hookean law where l³ = 1 + p² A²/4.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import Incompressible, MooneyRivlin, NeoHookean
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic
from .meshes import box, positive, vertices_at
from .problem import Problem

SOURCE = "closed form: Rivlin 1949, Large elastic deformations of isotropic materials VI"
LENGTH, TURN = 1.0, 1.0
POYNTING = (1.0 + TURN**2 / 4) ** (1 / 3)
"""The stretch without axial force of a neo-Hookean cylinder of radius 1 mm."""
LAWS = {"neo-Hookean": (0.5, 0.0), "Mooney-Rivlin": (0.2, 0.3)}
"""C10 and C01 [kPa]; the shear modulus is 1 kPa."""


def cylinder(cells: int) -> tuple[Floats, Ints]:
    """A cylinder along z [mm] of a square's (2 cells)² cells; its polygon has the polar moment of radius 1."""
    X, tets = box((2 * cells, 2 * cells, cells), (2.0, 2.0, LENGTH))
    flat = X[:, :2] - 1.0
    radius = np.maximum(np.abs(flat).max(axis=1, keepdims=True), 1e-300)
    flat = np.tan(np.pi / 4 * flat / radius)  # even angles along the sides
    flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300) * radius
    side = np.pi / (4 * cells)  # the angle that one sees, and its triangle's share of the sector's polar moment
    share = np.sin(side) * (2 + np.cos(side)) / (3 * side)
    X = np.column_stack([flat * share**-0.25, X[:, 2]])
    return X, positive(X, tets)


def turned(X: Floats, stretch: float) -> Floats:
    """Where places X [mm] of the cylinder go, shape (n, 3)."""
    angle = TURN * X[:, 2]
    x, y = X[:, 0] / np.sqrt(stretch), X[:, 1] / np.sqrt(stretch)
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * x - s * y, s * x + c * y, stretch * X[:, 2]])


def expected(C10: float, C01: float, stretch: float) -> float:
    """The energy [µJ]: area and polar moment of the unit circle times the density's two parts."""
    s = stretch
    area = C10 * (s**2 + 2 / s - 3) + C01 * (2 * s + s**-2 - 3)
    moment = TURN**2 * (C10 / s + C01 / s**2)
    return LENGTH * (np.pi * area + np.pi / 2 * moment)


def twisted(C10: float, C01: float, stretch: float, cells: int) -> Scene:
    """The cylinder with its ends held where they turn and stretch to."""
    law = MooneyRivlin(C10, C01) if C01 else NeoHookean(2 * C10, 2 * C10)
    X, tets = cylinder(cells)
    ends = np.concatenate([vertices_at(X, 2, height) for height in (0.0, LENGTH)])
    return Scene(X, tets, (Hyperelastic(Incompressible(law)), Fixed(ends, turned(X, stretch)[ends])))


def energy(scene: Scene, solution: Solution) -> float:
    """The energy [µJ]."""
    return solution.energy


def _problems(cells: int, bound: float) -> tuple[Problem, ...]:
    return tuple(
        Problem(
            f"twisted cylinder, {label}, stretch {stretch:.3f}, P2P1, {cells} cells: energy",
            SOURCE,
            partial(twisted, *moduli, stretch, cells),
            energy,
            expected(*moduli, stretch),
            {"fenicsx": bound},
            options={"element": "P2P1"},
            tolerance=1e-9,
        )
        for label, moduli in LAWS.items()
        for stretch in (1.0, POYNTING)
    )


PROBLEMS = (*_problems(2, 1e-2), *_problems(3, 5e-3))
FINE = _problems(4, 3e-3)
