"""Unit cubes on rollers, stretched along one axis or two: homogeneous, so exact on any mesh, slivers included (H4).

A row is posed with the stretch held and the free stretch sought, and with the nominal stress as a dead load and the
stretch sought. Under a compressive dead load the strain energy buckles (its Hessian at the homogeneous state is
indefinite), so there the energy of the held state stands for the stress, which is its derivative.
Corotated and St. Venant-Kirchhoff have closed forms. The values of the others solve one equation for the free stretch
(tests/verification/test_closed_forms.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints, tet_volumes
from ..materials import (
    Corotated,
    IsochoricNeoHookean,
    MooneyRivlin,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    Volumetric,
)
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Strain, Term, Traction, Volume
from .meshes import block, triangles_at, unstructured, vertices_at
from .problem import Attempt, HardCase, Problem, energy

CELLS = 3
LIMIT = 1.2
YOUNG, POISSON = 1.0, 0.45


@dataclass(frozen=True)
class Row:
    """A stretch along the first `loaded` axes, the stretch of the free ones and the nominal stress [kPa].

    The `confined` axes after the loaded ones keep their length.
    """

    label: str
    energies: tuple[Term, ...]
    loaded: int
    stretch: float
    free_stretch: float
    stress: float
    confined: int = 0


NEO_HOOKEAN = (Hyperelastic(NeoHookean.from_young(YOUNG, POISSON)),)
STRAIN = (Strain(1.0),)
STRAIN_AND_VOLUME = (Strain(1.0), Volume(10.0))
LIMITED = (Strain(1.0, limit=LIMIT),)
COROTATED = (Hyperelastic(Corotated.from_young(YOUNG, POISSON)),)
KIRCHHOFF = (Hyperelastic(StVenantKirchhoff.from_young(YOUNG, POISSON)),)
STABLE = (Hyperelastic(StableNeoHookean.from_young(YOUNG, POISSON)),)
QUADRATIC = (Hyperelastic(IsochoricNeoHookean.from_young(YOUNG, POISSON)),)
LOGARITHMIC = (Hyperelastic(IsochoricNeoHookean.from_young(YOUNG, POISSON, Volumetric.LOGARITHMIC)),)
POLYNOMIAL = (Hyperelastic(MooneyRivlin(C10=0.1, C01=0.05, kappa=10 / 3, C20=0.02)),)

NEO_HOOKEAN_ROWS = (
    Row("NeoHookean nu=.45, uniaxial", NEO_HOOKEAN, 1, 0.5, 1.3508697467, -1.0861028086),
    Row("NeoHookean nu=.45, uniaxial", NEO_HOOKEAN, 1, 1.5, 0.8306789808, 0.3586143519),
    Row("NeoHookean nu=.45, uniaxial", NEO_HOOKEAN, 1, 2.0, 0.7259350056, 0.5987962703),
    Row("NeoHookean nu=.45, uniaxial", NEO_HOOKEAN, 1, 3.0, 0.5983147092, 0.9933355757),
    Row("NeoHookean nu=.45, equibiaxial", NEO_HOOKEAN, 2, 1.5, 0.4839184956, 0.4634075608),
    Row("NeoHookean nu=.45, equibiaxial", NEO_HOOKEAN, 2, 2.0, 0.2770079198, 0.6764252780),
)
STRAIN_ROWS = (
    Row("Strain, uniaxial", STRAIN, 1, 0.5, 1.0, -0.5),
    Row("Strain, uniaxial", STRAIN, 1, 2.0, 1.0, 1.0),
    Row("Strain + 10 Volume, uniaxial", STRAIN_AND_VOLUME, 1, 0.5, 1.296099, -1.189891),
    Row("Strain + 10 Volume, uniaxial", STRAIN_AND_VOLUME, 1, 1.5, 0.835426, 0.590399),
    Row("Strain + 10 Volume, uniaxial", STRAIN_AND_VOLUME, 1, 2.0, 0.735254, 1.094268),
)
COMPRESSED_DENSITIES = ((STRAIN_ROWS[0], 0.125), (STRAIN_ROWS[2], 0.2452393))
LIMITED_ROW = Row("Strain beyond a limit, uniaxial", LIMITED, 1, 1.5, 1.0, 1.5 - LIMIT)

SOURCE = "closed form: one equation for the free stretch"
# The tables' digits bound the error.
TEN_DIGITS = {"fenicsx": 1e-9, "skfem": 1e-9}
SIX_DIGITS = {"projective": 2e-6, "fenicsx": 2e-6, "skfem": 2e-6}


def corotated(stretch: float, loaded: int) -> Row:
    """P is linear in the stretches: E (stretch - 1) along one axis, E/(1 - nu) (stretch - 1) along two."""
    away = stretch - 1
    if loaded == 1:
        return Row("Corotated nu=.45, uniaxial", COROTATED, 1, stretch, 1 - POISSON * away, YOUNG * away)
    free = 1 - 2 * POISSON / (1 - POISSON) * away
    return Row("Corotated nu=.45, equibiaxial", COROTATED, 2, stretch, free, YOUNG / (1 - POISSON) * away)


def kirchhoff(stretch: float) -> Row:
    """S = E e of Green's strain e = (stretch² - 1)/2; the free axes' strain is -nu e, and P = stretch S."""
    e = (stretch**2 - 1) / 2
    free = (1 - 2 * POISSON * e) ** 0.5
    return Row("StVenantKirchhoff nu=.45, uniaxial", KIRCHHOFF, 1, stretch, free, YOUNG * e * stretch)


CLOSED_ROWS = (
    *(corotated(stretch, 1) for stretch in (0.8, 1.5, 2.0)),
    *(corotated(stretch, 2) for stretch in (1.2, 1.5)),
    *(kirchhoff(stretch) for stretch in (1.2, 1.5)),
)
CRUSHED_ROW = corotated(0.5, 1)
SOLVED_ROWS = (
    Row("StableNeoHookean nu=.45, uniaxial", STABLE, 1, 0.7, 1.1673782584, -0.4372646134),
    Row("StableNeoHookean nu=.45, uniaxial", STABLE, 1, 2.0, 0.7228808390, 0.6671711837),
    Row("StableNeoHookean nu=.45, equibiaxial", STABLE, 2, 1.5, 0.4790507973, 0.5112212478),
    Row("IsochoricNeoHookean nu=.45 (quadratic), uniaxial", QUADRATIC, 1, 2.0, 0.7420503532, 0.5576728792),
    Row("IsochoricNeoHookean nu=.45 (quadratic), equibiaxial", QUADRATIC, 2, 1.5, 0.4956669842, 0.4284448055),
    Row("IsochoricNeoHookean nu=.45 (logarithmic), uniaxial", LOGARITHMIC, 1, 2.0, 0.7435047292, 0.5558704664),
    Row("IsochoricNeoHookean nu=.45 (logarithmic), equibiaxial", LOGARITHMIC, 2, 1.5, 0.4980810392, 0.4265481723),
    Row("MooneyRivlin with C20, uniaxial", POLYNOMIAL, 1, 2.0, 0.7460226037, 0.6294546814),
    Row("MooneyRivlin with C20, equibiaxial", POLYNOMIAL, 2, 1.5, 0.5148229027, 0.6114224614),
    Row("MooneyRivlin with C20, pure shear", POLYNOMIAL, 1, 1.5, 0.7153319328, 0.3787427959, confined=1),
)


def rollers(X: Floats) -> list[Term]:
    """The planes x = 0, y = 0, z = 0 slide in themselves."""
    return [Fixed(vertices_at(X, axis, 0.0), components=(axis,)) for axis in range(3)]


def confine(row: Row, X: Floats) -> list[Term]:
    """The far faces of the confined axes slide in themselves."""
    axes = range(row.loaded, row.loaded + row.confined)
    return [Fixed(vertices_at(X, axis, 1.0), components=(axis,)) for axis in axes]


def held_scene(row: Row, mesh: tuple[Floats, Ints] | None = None) -> Scene:
    """The far faces of the loaded axes held at the stretch, on a mesh of the unit cube."""
    X, tets = unstructured(CELLS) if mesh is None else mesh
    faces = [vertices_at(X, axis, 1.0) for axis in range(row.loaded)]
    ends: list[Term] = [Fixed(face, X[face] * row.stretch, components=(axis,)) for axis, face in enumerate(faces)]
    return Scene(X, tets, (*row.energies, *rollers(X), *confine(row, X), *ends))


def pulled_scene(row: Row) -> Scene:
    """The far faces of the loaded axes under the nominal stress."""
    X, tets = unstructured(CELLS)
    faces = [triangles_at(X, tets, axis, 1.0) for axis in range(row.loaded)]
    loads: list[Term] = [Traction(face, row.stress * np.eye(3)[axis]) for axis, face in enumerate(faces)]
    return Scene(X, tets, (*row.energies, *rollers(X), *confine(row, X), *loads))


def stretch_along(axis: int, reference: float) -> Callable[[Scene, Solution], float]:
    """Measure the stretch along `axis` at the far face, that of the vertex farthest from the reference."""

    def quantity(scene: Scene, solution: Solution) -> float:
        stretches = solution.positions[vertices_at(scene.vertices, axis, 1.0), axis]
        return stretches[np.argmax(np.abs(stretches - reference))]

    return quantity


def stretched_start(row: Row) -> Callable[[Scene], Floats]:
    """A start at the row's held stretch, its free stretch 1."""
    return lambda scene: scene.vertices * np.where(np.arange(3) < row.loaded, row.stretch, 1.0)


def free_stretch(row: Row, bounds: dict[str, float], source: str = SOURCE) -> Problem:
    """The free stretch where the row's stretch is held."""
    quantity = stretch_along(2, row.free_stretch)
    name = f"{row.label}, stretch {row.stretch:g}: free stretch"
    return Problem(name, source, lambda: held_scene(row), quantity, row.free_stretch, bounds, stretched_start(row))


def loaded_stretch(
    row: Row, bounds: dict[str, float], start: Callable[[Scene], Floats] | None = None, source: str = SOURCE
) -> Problem:
    """The stretch under the row's nominal stress as a dead load."""
    quantity = stretch_along(0, row.stretch)
    name = f"{row.label}, {row.stress:g} kPa: stretch"
    return Problem(name, source, lambda: pulled_scene(row), quantity, row.stretch, bounds, start)


def held_energy(row: Row, bounds: dict[str, float], density: float, source: str = SOURCE) -> Problem:
    """The energy where the row's stretch is held; its derivative by the stretch is the stress."""
    name = f"{row.label}, stretch {row.stretch:g}: energy"
    return Problem(name, source, lambda: held_scene(row), energy, density, bounds, stretched_start(row))


def _problems() -> list[Problem]:
    problems = []
    for row in NEO_HOOKEAN_ROWS:
        problems += [free_stretch(row, TEN_DIGITS), loaded_stretch(row, TEN_DIGITS)]
    for row in STRAIN_ROWS:
        problems.append(free_stretch(row, SIX_DIGITS))
        if row.stress > 0:
            problems.append(loaded_stretch(row, SIX_DIGITS))
    for row, density in COMPRESSED_DENSITIES:
        problems.append(held_energy(row, SIX_DIGITS, density))
    # The limit leaves the free stretch undetermined, so energy and loaded stretch are all there is to compare; at rest
    # it leaves no stiffness at all, so the load starts beyond it.
    beyond = (LIMITED_ROW.stretch - LIMIT) ** 2 / 2
    problems.append(held_energy(LIMITED_ROW, SIX_DIGITS, beyond))
    problems.append(loaded_stretch(LIMITED_ROW, SIX_DIGITS, lambda scene: scene.vertices * [LIMIT + 0.1, 1.0, 1.0]))
    for rows, source in ((CLOSED_ROWS, "closed form"), (SOLVED_ROWS, SOURCE)):
        for row in rows:
            problems += [free_stretch(row, TEN_DIGITS, source), loaded_stretch(row, TEN_DIGITS, source=source)]
    # A dead load that halves the corotated cube buckles it: the energy of the held state stands for the stress.
    crushed = YOUNG / 2 * (CRUSHED_ROW.stretch - 1) ** 2
    problems.append(free_stretch(CRUSHED_ROW, TEN_DIGITS, "closed form"))
    problems.append(held_energy(CRUSHED_ROW, TEN_DIGITS, crushed, "closed form"))
    return problems


PROBLEMS = tuple(_problems())

TOLERANCE = 1e-7
"""Rounding of F in the worst sliver leaves no more of the gradient."""

Mesh = Callable[[], tuple[Floats, Ints]]


def flat_layer(aspect: float) -> tuple[Floats, Ints]:
    """A layer of cells whose height is a width over `aspect`."""
    X, tets = block(CELLS)
    heights = np.array([0.0, 0.5, 0.5 + 1 / (CELLS * aspect), 1.0])
    X[:, 2] = heights[np.rint(CELLS * X[:, 2]).astype(int)]
    return X, tets


def sliver(height: float) -> tuple[Floats, Ints]:
    """An inner vertex that lies `height` [mm] above the middle of the face opposite in one of its tets."""
    X, tets = block(CELLS)
    vertex = int(np.argmin(np.linalg.norm(X - 1 / CELLS, axis=1)))
    tet = tets[(tets == vertex).any(axis=1)][0]
    a, b, c = X[tet[tet != vertex]]
    normal = np.cross(b - a, c - a)
    normal *= np.sign(normal @ (X[vertex] - a)) / np.linalg.norm(normal)
    X[vertex] = (a + b + c) / 3 + height * normal
    return X, tets


def of_volume(volume: float) -> tuple[Floats, Ints]:
    """A sliver of a volume [mm³]."""
    height = 1e-3
    return sliver(height * volume / float(tet_volumes(*sliver(height)).min()))


MESHES: dict[str, Mesh] = {
    "layer of aspect 1e2": partial(flat_layer, 1e2),
    "layer of aspect 1e3": partial(flat_layer, 1e3),
    "dihedral angle of .1°": partial(sliver, 2 * np.tan(np.radians(0.1)) / (3 * CELLS)),
    "tet of 1e-12 mm³": partial(of_volume, 1e-12),
}
ALL, NEWTON, MIXED = ("projective", "fenicsx", "skfem"), ("fenicsx", "skfem"), ("P1", "P2", "P2P1")
ROWS: tuple[tuple[Row, tuple[str, ...], tuple[str, ...]], ...] = (
    (STRAIN_ROWS[3], ALL, ("P1", "P2")),
    (NEO_HOOKEAN_ROWS[1], NEWTON, MIXED),
)


def position_error(row: Row, mesh: Mesh, attempt: Attempt) -> float:
    """The largest distance [mm] of a vertex from the homogeneous stretch."""
    scene = held_scene(row, mesh())
    exact = scene.vertices * [row.stretch, row.free_stretch, row.free_stretch]
    start = scene.vertices * [row.stretch, 1.0, 1.0]
    positions = attempt.solve(attempt.prepare(scene), start=start, tolerance=TOLERANCE).positions
    return float(np.linalg.norm(positions - exact, axis=1).max())


CASES = tuple(
    HardCase(
        f"{name}, {row.label}",
        "H4; V2",
        "positions within 1e-6 of the cube's size",
        partial(position_error, row, mesh),
        1e-6,
        solvers,
        elements,
    )
    for row, solvers, elements in ROWS
    for name, mesh in MESHES.items()
)
