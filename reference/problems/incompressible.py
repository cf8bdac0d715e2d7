"""Incompressible bodies with closed forms: a thick sphere under pressure, a bent block, a cube.

Sphere (V9), an eighth of it by symmetry: P = mu (2/b + 1/(2 b⁴) - 2/a - 1/(2 a⁴)), a and b the stretches of the inner
and the outer surface, which volume ties (Ogden 1984, "Non-linear Elastic Deformations", Section 5.3.2). P has a
maximum, a limit point under pressure control.

Block, bent to a sector of a tube in plane strain (Rivlin 1949): a section at height Y turns by Y/a, and X goes to the
radius r = √(2 a X + b): stretches r/a along and a/r across, so volume is kept. Without tractions on the curved faces
their radii multiply to a², which gives b. The energy is the same for all laws of the invariants' sum C10 + C01, as
I1 = I2 in plane strain.

H14, loads that no stable equilibrium bears; the answer is "limit point", not "diverged". Rivlin's cube: an
incompressible neo-Hookean cube under the same dead traction t along every face's normal keeps its shape as an
equilibrium for every t, but from t = 2 mu on it is unstable (Rivlin 1974, "Stability of pure homogeneous deformations
of an elastic cube under dead loading").
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import Incompressible, IsochoricNeoHookean, Material, MooneyRivlin, NeoHookean
from ..scene import Scene
from ..solution import Reason, Solution
from ..terms import Fixed, Hyperelastic, Pressure, Traction
from .homogeneous import rollers
from .meshes import block, boundary_triangles, box, positive, triangles_at, vertices_at
from .problem import Attempt, HardCase, Problem, mixed_problem

SPHERE_SOURCE = "closed form: Ogden 1984, Section 5.3.2"
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
            *rollers(X),
            Pressure(inner, pressure),
        ),
    )


def inner_stretch(scene: Scene, solution: Solution) -> float:
    """The mean stretch of the inner surface's vertices."""
    inner = np.isclose(np.linalg.norm(scene.vertices, axis=1), INNER)
    return float(np.linalg.norm(solution.positions[inner], axis=1).mean() / INNER)


def load_reached(scene: Scene, solution: Solution) -> float:
    """The pressure [kPa] of the last equilibrium."""
    (pressure,) = scene.of(Pressure)
    return float(pressure.value) * solution.detail["load_share"]


def _spheres(
    sizes: tuple[tuple[int, int], ...], bounds: tuple[float, ...], limited: tuple[int, int]
) -> tuple[Problem, ...]:
    inflated = [
        mixed_problem(
            f"thick sphere, P/mu=.755, P2P1, {n}x{layers} cells: inner stretch",
            SPHERE_SOURCE,
            partial(sphere, PRESSURE_AT_HALF, n, layers),
            inner_stretch,
            1.5,
            {"fenicsx": bound},
        )
        for (n, layers), bound in zip(sizes, bounds, strict=True)
    ]
    beyond = mixed_problem(
        f"thick sphere, P/mu=.83, P2P1, {limited[0]}x{limited[1]} cells: limit point",
        SPHERE_SOURCE,
        partial(sphere, 0.83, *limited),
        load_reached,
        LIMIT_PRESSURE,
        {"fenicsx": 1e-2},
        reason=Reason.LIMIT_POINT,
    )
    return (*inflated, beyond)


# The flat faces' error of the radius is of second order in the cells.
SPHERES = _spheres(((4, 3), (6, 4)), (0.02, 0.01), (4, 3))
FINE_SPHERES = _spheres(((10, 6),), (0.004,), (6, 4))


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


SHEAR, BULK = 1.0, 1e3
BEYOND, BELOW = 2.2, 1.8
"""Tractions over the shear modulus."""


def rivlin_cube(material: Material, traction: float) -> Scene:
    """An eighth of Rivlin's cube by symmetry, 1 mm wide, under a traction [kPa] along the normals."""
    X, tets = block(3)
    loads = [Traction(triangles_at(X, tets, axis, 1.0), traction * np.eye(3)[axis]) for axis in range(3)]
    return Scene(X, tets, (Hyperelastic(material), *rollers(X), *loads))


def load_error(material: Material, attempt: Attempt) -> float:
    """How far the last equilibrium's traction is from 2 mu, relative to it."""
    scene = rivlin_cube(material, BEYOND * SHEAR)
    share = attempt.solve(attempt.prepare(scene)).detail["load_share"]
    return abs(share * BEYOND / 2.0 - 1.0)


def shape_error(material: Material, attempt: Attempt) -> float:
    """The largest displacement [mm] below the limit, less what a bulk modulus leaves of it."""
    scene = rivlin_cube(material, BELOW * SHEAR)
    moved = attempt.solve(attempt.prepare(scene)).positions - scene.vertices
    swollen = 0.0 if isinstance(material, Incompressible) else BELOW * SHEAR / (3 * BULK)
    return float(np.abs(moved - swollen * scene.vertices).max())


def pressure_error(attempt: Attempt) -> float:
    """How far the last equilibrium's pressure is from the sphere's largest, relative to it."""
    scene = sphere(0.83, 4, 3)
    return abs(load_reached(scene, attempt.solve(attempt.prepare(scene), tolerance=1e-9)) / LIMIT_PRESSURE - 1.0)


NEARLY = IsochoricNeoHookean(SHEAR, BULK)
CUBE_LAWS: dict[str, tuple[Material, tuple[str, ...]]] = {
    "nearly incompressible": (NEARLY, ("P1", "P2", "P2P1")),
    "incompressible": (Incompressible(IsochoricNeoHookean(SHEAR)), ("P2P1",)),
}
SOLVER, LIMIT = ("fenicsx",), ("LIMIT_POINT",)
CASES = (
    *(
        case
        for label, (material, elements) in CUBE_LAWS.items()
        for case in (
            HardCase(
                f"Rivlin's cube, t = 2.2 mu, {label}",
                "H14; Rivlin 1974",
                'says "limit point", within 1 % of t = 2 mu',
                partial(load_error, material),
                1e-2,
                SOLVER,
                elements,
                LIMIT,
            ),
            HardCase(
                f"Rivlin's cube, t = 1.8 mu, {label}",
                "H14; Rivlin 1974",
                "positions within 1e-4 of the cube's size",
                partial(shape_error, material),
                1e-4,
                SOLVER,
                elements,
            ),
        )
    ),
    HardCase(
        "thick sphere, P/mu = .83",
        "H14; V9",
        'says "limit point", within 1 % of the largest pressure',
        pressure_error,
        1e-2,
        SOLVER,
        ("P2P1",),
        LIMIT,
    ),
)

PROBLEMS = (*SPHERES, *BENT)
FINE = (*FINE_SPHERES, *FINE_BENT)
