"""A block of an incompressible law bent to a sector of a tube, in plane strain (Rivlin 1949).

A section at height Y turns by Y/a, and X goes to the radius r = √(2 a X + b): stretches r/a along and a/r across, so
volume is kept. Without tractions on the curved faces their radii multiply to a², which gives b. The energy is the same
for all laws of the invariants' sum C10 + C01, as I1 = I2 in plane strain.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats
from ..materials import Incompressible, IsochoricNeoHookean, Material, MooneyRivlin
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic
from .meshes import box, vertices_at
from .problem import Problem

SOURCE = "closed form: Rivlin 1949, Large elastic deformations of isotropic materials V"
LENGTH, RADIUS = 3.0, 1.5
LAWS: tuple[Incompressible, ...] = (Incompressible(IsochoricNeoHookean(1.0)), Incompressible(MooneyRivlin(0.3, 0.2)))


def offset() -> float:
    """The offset b [mm²] for a block of thickness 1 mm: (b - a)(b + a) = a⁴."""
    return float(np.sqrt(RADIUS**4 + RADIUS**2))


def bent(X: Floats) -> Floats:
    """Where places X [mm] of the block go, shape (n, 3)."""
    r = np.sqrt(2 * RADIUS * X[:, 0] + offset())
    angle = X[:, 1] / RADIUS
    return np.column_stack([r * np.cos(angle) - RADIUS, r * np.sin(angle), X[:, 2]])


def energy_per_depth() -> float:
    """Energy [µJ/mm] of shear modulus 1 kPa: the integral of (r²/a² + a²/r² - 2)/2 over the block."""
    a, b = RADIUS, offset()
    return LENGTH * (b / a**2 + a / 2 * np.log((b + a) / (b - a)) - 2) / 2


def block(law: Material, cells: int) -> Scene:
    """A block of 1 x 3 mm in cells x 3 cells, its ends held where they turn to, its sides in their planes."""
    X, tets = box((cells, 3 * cells, 1), (1.0, LENGTH, 1.0 / cells))
    X = X - [0.5, LENGTH / 2, 0.0]
    ends = np.flatnonzero(np.isclose(np.abs(X[:, 1]), LENGTH / 2))
    sides = np.concatenate([vertices_at(X, 2, height) for height in (0.0, 1.0 / cells)])
    return Scene(X, tets, (Hyperelastic(law), Fixed(ends, bent(X)[ends]), Fixed(sides, components=(2,))))


def energy(scene: Scene, solution: Solution) -> float:
    """Energy per depth [µJ/mm]."""
    return solution.energy / float(np.ptp(scene.vertices[:, 2]))


def inner_radius(scene: Scene, solution: Solution) -> float:
    """The radius [mm] of the inner face in the middle of the block, the mean through its depth."""
    middle = np.isclose(scene.vertices[:, :2], [-0.5, 0.0], atol=1e-9).all(axis=1)
    return float((solution.positions[middle, 0] + RADIUS).mean())


def _problems(cells: int, bounds: tuple[float, float]) -> tuple[Problem, ...]:
    radius = float(np.sqrt(offset() - RADIUS))
    return tuple(
        Problem(
            f"bent block, {law.law.name}, P2P1, {cells} cells: {what}",
            SOURCE,
            partial(block, law, cells),
            quantity,
            value,
            {"fenicsx": bound},
            options={"element": "P2P1"},
            tolerance=1e-9,
        )
        for law in LAWS
        for (what, quantity, value), bound in zip(
            (("energy", energy, energy_per_depth()), ("inner radius", inner_radius, radius)), bounds, strict=True
        )
    )


# The ends are held where their vertices turn to, straight in between: an error of second order in the cells.
PROBLEMS = (*_problems(4, (3e-3, 1e-2)), *_problems(6, (1e-3, 5e-3)))
FINE = _problems(10, (1e-3, 1e-3))
