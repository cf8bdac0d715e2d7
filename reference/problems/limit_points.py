"""H14: dead loads and pressures that no stable equilibrium bears; the answer is "limit point", not "diverged".

Rivlin's cube: an incompressible neo-Hookean cube under the same dead traction t along every face's normal keeps its
shape as an equilibrium for every t, but from t = 2 mu on it is unstable (Rivlin 1974, "Stability of pure homogeneous
deformations of an elastic cube under dead loading"). The thick sphere of V9 has a largest pressure.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ..materials import Incompressible, IsochoricNeoHookean, Material
from ..scene import Scene
from ..terms import Hyperelastic, Traction
from .hard_case import Attempt, HardCase
from .homogeneous import rollers
from .meshes import block, triangles_at
from .thick_sphere import LIMIT_PRESSURE, load_reached, sphere

SHEAR, BULK = 1.0, 1e3
BEYOND, BELOW = 2.2, 1.8
"""Tractions over the shear modulus."""


def cube(material: Material, traction: float) -> Scene:
    """An eighth of Rivlin's cube by symmetry, 1 mm wide, under a traction [kPa] along the normals."""
    X, tets = block(3)
    loads = [Traction(triangles_at(X, tets, axis, 1.0), traction * np.eye(3)[axis]) for axis in range(3)]
    return Scene(X, tets, (Hyperelastic(material), *rollers(X), *loads))


def load_error(material: Material, attempt: Attempt) -> float:
    """How far the last equilibrium's traction is from 2 mu, relative to it."""
    scene = cube(material, BEYOND * SHEAR)
    share = attempt.solve(attempt.prepare(scene)).detail["load_share"]
    return abs(share * BEYOND / 2.0 - 1.0)


def shape_error(material: Material, attempt: Attempt) -> float:
    """The largest displacement [mm] below the limit, less what a bulk modulus leaves of it."""
    scene = cube(material, BELOW * SHEAR)
    moved = attempt.solve(attempt.prepare(scene)).positions - scene.vertices
    swollen = 0.0 if isinstance(material, Incompressible) else BELOW * SHEAR / (3 * BULK)
    return float(np.abs(moved - swollen * scene.vertices).max())


def pressure_error(attempt: Attempt) -> float:
    """How far the last equilibrium's pressure is from the sphere's largest, relative to it."""
    scene = sphere(0.83, 4, 3)
    return abs(load_reached(scene, attempt.solve(attempt.prepare(scene), tolerance=1e-9)) / LIMIT_PRESSURE - 1.0)


NEARLY = IsochoricNeoHookean(SHEAR, BULK)
LAWS: dict[str, tuple[Material, tuple[str, ...]]] = {
    "nearly incompressible": (NEARLY, ("P1", "P2", "P2P1")),
    "incompressible": (Incompressible(IsochoricNeoHookean(SHEAR)), ("P2P1",)),
}
SOLVER, LIMIT = ("fenicsx",), ("LIMIT_POINT",)
CASES = (
    *(
        case
        for label, (material, elements) in LAWS.items()
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
