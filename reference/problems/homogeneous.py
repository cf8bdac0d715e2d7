"""Unit cubes on rollers, stretched along one axis or two: homogeneous, so exact on any mesh.

A row is posed with the stretch held and the free stretch sought, and with the nominal stress as a dead load and the
stretch sought. Under a compressive dead load the strain energy buckles (its Hessian at the homogeneous state is
indefinite), so there the energy of the held state stands for the stress, which is its derivative.
The values solve one equation for the free stretch (tests/verification/test_closed_forms.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..materials import NeoHookean
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Strain, Term, Traction, Volume
from .meshes import triangles_at, unstructured, vertices_at
from .problem import Problem

CELLS = 3
LIMIT = 1.2


@dataclass(frozen=True)
class Row:
    """A stretch along the first `loaded` axes, the stretch of the free ones and the nominal stress [kPa].

    The `confined` axes after the loaded ones keep their length.
    """

    label: str
    energies: Callable[[], list[Term]]
    loaded: int
    stretch: float
    free_stretch: float
    stress: float
    confined: int = 0


def neo_hookean() -> list[Term]:
    """Young's modulus 1 kPa, Poisson's ratio .45."""
    return [Hyperelastic(NeoHookean.from_young(1.0, 0.45))]


def strain() -> list[Term]:
    """1/2 ‖F - R‖²."""
    return [Strain(1.0)]


def strain_and_volume() -> list[Term]:
    """1/2 ‖F - R‖² and ten times as much volume."""
    return [Strain(1.0), Volume(10.0)]


def limited_strain() -> list[Term]:
    """Free up to the limit, (stretch - limit)²/2 beyond it."""
    return [Strain(1.0, limit=LIMIT)]


NEO_HOOKEAN_ROWS = (
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 0.5, 1.3508697467, -1.0861028086),
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 1.5, 0.8306789808, 0.3586143519),
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 2.0, 0.7259350056, 0.5987962703),
    Row("NeoHookean nu=.45, uniaxial", neo_hookean, 1, 3.0, 0.5983147092, 0.9933355757),
    Row("NeoHookean nu=.45, equibiaxial", neo_hookean, 2, 1.5, 0.4839184956, 0.4634075608),
    Row("NeoHookean nu=.45, equibiaxial", neo_hookean, 2, 2.0, 0.2770079198, 0.6764252780),
)
STRAIN_ROWS = (
    Row("Strain, uniaxial", strain, 1, 0.5, 1.0, -0.5),
    Row("Strain, uniaxial", strain, 1, 2.0, 1.0, 1.0),
    Row("Strain + 10 Volume, uniaxial", strain_and_volume, 1, 0.5, 1.296099, -1.189891),
    Row("Strain + 10 Volume, uniaxial", strain_and_volume, 1, 1.5, 0.835426, 0.590399),
    Row("Strain + 10 Volume, uniaxial", strain_and_volume, 1, 2.0, 0.735254, 1.094268),
)
COMPRESSED_DENSITIES = ((STRAIN_ROWS[0], 0.125), (STRAIN_ROWS[2], 0.2452393))
LIMITED_ROW = Row("Strain beyond a limit, uniaxial", limited_strain, 1, 1.5, 1.0, 1.5 - LIMIT)

SOURCE = "closed form: one equation for the free stretch"
# The tables' digits bound the error.
TEN_DIGITS = {"fenicsx": 1e-9, "skfem": 1e-9}
SIX_DIGITS = {"projective": 2e-6, "fenicsx": 2e-6, "skfem": 2e-6}


def rollers(X: Floats) -> list[Term]:
    """The planes x = 0, y = 0, z = 0 slide in themselves."""
    return [Fixed(vertices_at(X, axis, 0.0), components=(axis,)) for axis in range(3)]


def confined(row: Row, X: Floats) -> list[Term]:
    """The far faces of the confined axes slide in themselves."""
    axes = range(row.loaded, row.loaded + row.confined)
    return [Fixed(vertices_at(X, axis, 1.0), components=(axis,)) for axis in axes]


def held(row: Row, mesh: tuple[Floats, Ints] | None = None) -> Scene:
    """The far faces of the loaded axes held at the stretch, on a mesh of the unit cube."""
    X, tets = unstructured(CELLS) if mesh is None else mesh
    faces = [vertices_at(X, axis, 1.0) for axis in range(row.loaded)]
    ends: list[Term] = [Fixed(face, X[face] * row.stretch, components=(axis,)) for axis, face in enumerate(faces)]
    return Scene(X, tets, (*row.energies(), *rollers(X), *confined(row, X), *ends))


def pulled(row: Row) -> Scene:
    """The far faces of the loaded axes under the nominal stress."""
    X, tets = unstructured(CELLS)
    faces = [triangles_at(X, tets, axis, 1.0) for axis in range(row.loaded)]
    loads: list[Term] = [Traction(face, row.stress * np.eye(3)[axis]) for axis, face in enumerate(faces)]
    return Scene(X, tets, (*row.energies(), *rollers(X), *confined(row, X), *loads))


def stretch_along(axis: int, reference: float) -> Callable[[Scene, Solution], float]:
    """Of the vertices at the far face, the stretch along `axis` that is farthest from the reference."""

    def quantity(scene: Scene, solution: Solution) -> float:
        stretches = solution.positions[vertices_at(scene.vertices, axis, 1.0), axis]
        return stretches[np.argmax(np.abs(stretches - reference))]

    return quantity


def energy(scene: Scene, solution: Solution) -> float:
    """The energy [µJ], which for the unit cube is the density [kPa]."""
    return solution.energy


def _stretched(row: Row) -> Callable[[Scene], Floats]:
    """A start at the row's held stretch, its free stretch 1."""
    return lambda scene: scene.vertices * np.where(np.arange(3) < row.loaded, row.stretch, 1.0)


def free_stretch(row: Row, bounds: dict[str, float], source: str = SOURCE) -> Problem:
    """The free stretch where the row's stretch is held."""
    quantity = stretch_along(2, row.free_stretch)
    name = f"{row.label}, stretch {row.stretch:g}: free stretch"
    return Problem(name, source, lambda: held(row), quantity, row.free_stretch, bounds, _stretched(row))


def under_load(
    row: Row, bounds: dict[str, float], start: Callable[[Scene], Floats] | None = None, source: str = SOURCE
) -> Problem:
    """The stretch under the row's nominal stress as a dead load."""
    quantity = stretch_along(0, row.stretch)
    name = f"{row.label}, {row.stress:g} kPa: stretch"
    return Problem(name, source, lambda: pulled(row), quantity, row.stretch, bounds, start)


def held_energy(row: Row, bounds: dict[str, float], density: float, source: str = SOURCE) -> Problem:
    """The energy where the row's stretch is held; its derivative by the stretch is the stress."""
    name = f"{row.label}, stretch {row.stretch:g}: energy"
    return Problem(name, source, lambda: held(row), energy, density, bounds, _stretched(row))


def _problems() -> list[Problem]:
    problems = []
    for row in NEO_HOOKEAN_ROWS:
        problems += [free_stretch(row, TEN_DIGITS), under_load(row, TEN_DIGITS)]
    for row in STRAIN_ROWS:
        problems.append(free_stretch(row, SIX_DIGITS))
        if row.stress > 0:
            problems.append(under_load(row, SIX_DIGITS))
    for row, density in COMPRESSED_DENSITIES:
        problems.append(held_energy(row, SIX_DIGITS, density))
    # The limit leaves the free stretch undetermined, so energy and loaded stretch are all there is to compare; at rest
    # it leaves no stiffness at all, so the load starts beyond it.
    beyond = (LIMITED_ROW.stretch - LIMIT) ** 2 / 2
    problems.append(held_energy(LIMITED_ROW, SIX_DIGITS, beyond))
    problems.append(under_load(LIMITED_ROW, SIX_DIGITS, lambda scene: scene.vertices * [LIMIT + 0.1, 1.0, 1.0]))
    return problems


PROBLEMS = tuple(_problems())
