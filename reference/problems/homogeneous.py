"""Unit cubes on rollers, stretched along one axis or two: homogeneous, so exact on any mesh.

Each row is posed twice: with the stretch held and the free stretch sought, and with the nominal stress as a dead load
and the stretch sought. The values solve one equation for the free stretch (tests/verification/test_closed_forms.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...lhm.mesh import Floats
from ..materials import NeoHookean
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Strain, Term, Traction, Volume
from .meshes import triangles_at, unstructured, vertices_at
from .problem import Problem

CELLS = 3


@dataclass(frozen=True)
class Row:
    """A stretch along the first `loaded` axes, the stretch of the others and the nominal stress [kPa]."""

    label: str
    energies: Callable[[], list[Term]]
    loaded: int
    stretch: float
    free_stretch: float
    stress: float


def neo_hookean() -> list[Term]:
    """Young's modulus 1 kPa, Poisson's ratio .45."""
    return [Hyperelastic(NeoHookean.from_young(1.0, 0.45))]


def strain() -> list[Term]:
    """1/2 ‖F - R‖²."""
    return [Strain(1.0)]


def strain_and_volume() -> list[Term]:
    """1/2 ‖F - R‖² and ten times as much volume."""
    return [Strain(1.0), Volume(10.0)]


NEO_HOOKEAN_ROWS = (
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 0.5, 1.3508697467, -1.0861028086),
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 1.5, 0.8306789808, 0.3586143519),
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 2.0, 0.7259350056, 0.5987962703),
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 3.0, 0.5983147092, 0.9933355757),
    Row("NeoHookean nu=.45, equibiaxial", neo_hookean, 2, 1.5, 0.4839184956, 0.4634075608),
    Row("NeoHookean nu=.45, equibiaxial", neo_hookean, 2, 2.0, 0.2770079198, 0.6764252780),
)
PROJECTIVE_ROWS = (
    Row("Strain, uniaxial", strain, 1, 0.5, 1.0, -0.5),
    Row("Strain, uniaxial", strain, 1, 2.0, 1.0, 1.0),
    Row("Strain + 10 Volume, uniaxial", strain_and_volume, 1, 0.5, 1.296099, -1.189891),
    Row("Strain + 10 Volume, uniaxial", strain_and_volume, 1, 1.5, 0.835426, 0.590399),
    Row("Strain + 10 Volume, uniaxial", strain_and_volume, 1, 2.0, 0.735254, 1.094268),
)


def rollers(X: Floats) -> list[Term]:
    """The planes x = 0, y = 0, z = 0 slide in themselves."""
    return [Fixed(vertices_at(X, axis, 0.0), components=(axis,)) for axis in range(3)]


def held(row: Row) -> Scene:
    """The far faces of the loaded axes held at the stretch."""
    X, tets = unstructured(CELLS)
    faces = [vertices_at(X, axis, 1.0) for axis in range(row.loaded)]
    ends: list[Term] = [Fixed(face, X[face] * row.stretch, components=(axis,)) for axis, face in enumerate(faces)]
    return Scene(X, tets, [*row.energies(), *rollers(X), *ends])


def pulled(energies: Callable[[], list[Term]], loaded: int, stress: float) -> Scene:
    """The far faces of the loaded axes under a nominal stress [kPa]."""
    X, tets = unstructured(CELLS)
    loads: list[Term] = [Traction(triangles_at(X, tets, axis, 1.0), stress * np.eye(3)[axis]) for axis in range(loaded)]
    return Scene(X, tets, [*energies(), *rollers(X), *loads])


def stretch_along(axis: int, reference: float) -> Callable[[Scene, Solution], float]:
    """Of the vertices at the far face, the stretch along `axis` that is farthest from the reference."""

    def quantity(scene: Scene, solution: Solution) -> float:
        stretches = solution.positions[vertices_at(scene.vertices, axis, 1.0), axis]
        return stretches[np.argmax(np.abs(stretches - reference))]

    return quantity


def _posed_twice(row: Row, bounds: dict[str, float], source: str) -> list[Problem]:
    name = f"{row.label}, stretch {row.stretch:g}"
    return [
        Problem(
            f"{name}: free stretch",
            source,
            lambda: held(row),
            stretch_along(2, row.free_stretch),
            row.free_stretch,
            bounds,
            lambda scene: scene.vertices * np.where(np.arange(3) < row.loaded, row.stretch, 1.0),
        ),
        Problem(
            f"{name}: stretch under {row.stress:g} kPa",
            source,
            lambda: pulled(row.energies, row.loaded, row.stress),
            stretch_along(0, row.stretch),
            row.stretch,
            bounds,
        ),
    ]


def _strain_limit(limit: float, stretch: float) -> list[Problem]:
    """Free up to the limit, linear beyond: psi = (stretch - limit)²/2; the free stretch is not determined."""

    def energies() -> list[Term]:
        return [Strain(1.0, limit=limit)]

    row = Row("Strain with limit", energies, 1, stretch, 1.0, stretch - limit)
    bounds = {"projective": 1e-8, "fenicsx": 1e-9, "skfem": 1e-9}
    source = "closed form: P = ws (stretch - limit) beyond the limit"
    name = f"Strain with limit {limit:g}, stretch {stretch:g}"
    return [
        Problem(
            f"{name}: energy",
            source,
            lambda: held(row),
            lambda scene, solution: solution.energy,
            (stretch - limit) ** 2 / 2,
            bounds,
        ),
        Problem(
            f"{name}: stretch under {row.stress:g} kPa",
            source,
            lambda: pulled(energies, 1, row.stress),
            stretch_along(0, stretch),
            stretch,
            bounds,
        ),
    ]


def _problems() -> list[Problem]:
    # The tables' digits bound the error: ten for NeoHookean, six for projective dynamics' energies.
    printed = {"projective": 2e-6, "fenicsx": 2e-6, "skfem": 2e-6}
    problems = []
    for row in NEO_HOOKEAN_ROWS:
        problems += _posed_twice(
            row, {"fenicsx": 1e-9, "skfem": 1e-9}, "closed form: one equation for the free stretch"
        )
    for row in PROJECTIVE_ROWS:
        problems += _posed_twice(row, printed, "closed form: one equation for the free stretch")
    return problems + _strain_limit(1.2, 1.5)


PROBLEMS = tuple(_problems())
