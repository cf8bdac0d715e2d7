"""Incompressible bodies with closed forms: a thick tube under pressure, and a bent block.

Tube, a quarter of it by symmetry, in plane strain: P = mu (ln(a/b) + (1/b² - 1/a²)/2), a and b the stretches of the
inner and the outer surface, which volume ties (Ogden 1984, "Non-linear Elastic Deformations", Section 5.3.1).

Block, bent to a sector of a tube in plane strain (Rivlin 1949): a section at height Y turns by Y/a, and X goes to the
radius r = √(2 a X + b): stretches r/a along and a/r across, so volume is kept. Without tractions on the curved faces
their radii multiply to a², which gives b. The energy is the same for all laws of the invariants' sum C10 + C01, as
I1 = I2 in plane strain.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats
from ..materials import Incompressible, IsochoricNeoHookean, Material, MooneyRivlin, NeoHookean
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Pressure
from .homogeneous import rollers
from .meshes import box, triangles_at, vertices_at
from .problem import Problem, mixed_problem

TUBE_SOURCE = "closed form: Ogden 1984, Section 5.3.1"
INNER, OUTER, STRETCH = 1.0, 2.0, 1.5
"""Radii at rest [mm], and the stretch of the inner surface."""


def tube_pressure() -> float:
    """Pressure by shear modulus that stretches the inner surface by STRETCH."""
    outer = np.sqrt(OUTER**2 + (STRETCH**2 - 1) * INNER**2) / OUTER
    return float(np.log(STRETCH / outer) + (1 / outer**2 - 1 / STRETCH**2) / 2)


def tube(cells: int) -> Scene:
    """A quarter of the tube of shear modulus 1 kPa, its ends in their planes, under an internal pressure."""
    X, tets = box((cells, 2 * cells, 1), (1.0, 1.0, 1.0 / cells))
    radius, angle = INNER * (OUTER / INNER) ** X[:, 0], np.pi / 2 * X[:, 1]
    places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), X[:, 2]])
    return Scene(
        places,
        tets,
        (
            Hyperelastic(Incompressible(NeoHookean(1.0, 1.0))),
            *rollers(places),
            Fixed(vertices_at(X, 2, 1.0 / cells), components=(2,)),
            Pressure(triangles_at(X, tets, 0, 0.0), tube_pressure()),
        ),
    )


def inner_stretch(scene: Scene, solution: Solution) -> float:
    """The mean stretch of the inner surface's vertices."""
    inner = np.isclose(np.hypot(*scene.vertices[:, :2].T), INNER)
    return float(np.hypot(*solution.positions[inner, :2].T).mean() / INNER)


def _tubes(cells: tuple[int, ...], bounds: tuple[float, ...]) -> tuple[Problem, ...]:
    return tuple(
        mixed_problem(
            f"thick tube under pressure, P2P1, {n} cells: inner stretch",
            TUBE_SOURCE,
            partial(tube, n),
            inner_stretch,
            STRETCH,
            {"fenicsx": bound},
        )
        for n, bound in zip(cells, bounds, strict=True)
    )


# The flat faces' error of the radius is of second order in the cells.
TUBES = _tubes((4, 6), (5e-3, 2e-3))
FINE_TUBES = _tubes((10,), (1e-3,))


FLEXURE_SOURCE = "closed form: Rivlin 1949, Large elastic deformations of isotropic materials V"
BLOCK_LENGTH, BLOCK_RADIUS = 3.0, 1.5
BLOCK_LAWS: tuple[Incompressible, ...] = (
    Incompressible(IsochoricNeoHookean(1.0)),
    Incompressible(MooneyRivlin(0.3, 0.2)),
)


def offset() -> float:
    """The offset b [mm²] for a block of thickness 1 mm: (b - a)(b + a) = a⁴."""
    return float(np.sqrt(BLOCK_RADIUS**4 + BLOCK_RADIUS**2))


def bend(X: Floats) -> Floats:
    """Where places X [mm] of the block go, shape (n, 3)."""
    r = np.sqrt(2 * BLOCK_RADIUS * X[:, 0] + offset())
    angle = X[:, 1] / BLOCK_RADIUS
    return np.column_stack([r * np.cos(angle) - BLOCK_RADIUS, r * np.sin(angle), X[:, 2]])


def energy_per_depth() -> float:
    """Energy [µJ/mm] of shear modulus 1 kPa: the integral of (r²/a² + a²/r² - 2)/2 over the block."""
    a, b = BLOCK_RADIUS, offset()
    return BLOCK_LENGTH * (b / a**2 + a / 2 * np.log((b + a) / (b - a)) - 2) / 2


def bent_block(law: Material, cells: int) -> Scene:
    """A block of 1 x 3 mm in cells x 3 cells, its ends held where they turn to, its sides in their planes."""
    X, tets = box((cells, 3 * cells, 1), (1.0, BLOCK_LENGTH, 1.0 / cells))
    X = X - [0.5, BLOCK_LENGTH / 2, 0.0]
    ends = np.flatnonzero(np.isclose(np.abs(X[:, 1]), BLOCK_LENGTH / 2))
    sides = np.concatenate([vertices_at(X, 2, height) for height in (0.0, 1.0 / cells)])
    return Scene(X, tets, (Hyperelastic(law), Fixed(ends, bend(X)[ends]), Fixed(sides, components=(2,))))


def bending_energy(scene: Scene, solution: Solution) -> float:
    """Energy per depth [µJ/mm]."""
    return solution.energy / float(np.ptp(scene.vertices[:, 2]))


def inner_radius(scene: Scene, solution: Solution) -> float:
    """The radius [mm] of the inner face in the middle of the block, the mean through its depth."""
    middle = np.isclose(scene.vertices[:, :2], [-0.5, 0.0], atol=1e-9).all(axis=1)
    return float((solution.positions[middle, 0] + BLOCK_RADIUS).mean())


def _bent(cells: int, bounds: tuple[float, float]) -> tuple[Problem, ...]:
    radius = float(np.sqrt(offset() - BLOCK_RADIUS))
    return tuple(
        mixed_problem(
            f"bent block, {law.law.name}, P2P1, {cells} cells: {name}",
            FLEXURE_SOURCE,
            partial(bent_block, law, cells),
            quantity,
            value,
            {"fenicsx": bound},
        )
        for law in BLOCK_LAWS
        for (name, quantity, value), bound in zip(
            (("energy", bending_energy, energy_per_depth()), ("inner radius", inner_radius, radius)),
            bounds,
            strict=True,
        )
    )


# The ends are held where their vertices turn to, straight in between: an error of second order in the cells.
BENT = (*_bent(4, (3e-3, 1e-2)), *_bent(6, (1e-3, 5e-3)))
FINE_BENT = _bent(10, (1e-3, 1e-3))

PROBLEMS = (*TUBES, *BENT)
FINE = (*FINE_TUBES, *FINE_BENT)
