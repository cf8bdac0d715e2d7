"""The patch test and rigid motions: what any solver must give on any mesh (Irons and Razzaque 1972)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from ...lhm.base.mesh import Floats
from ..materials import Corotated, Material, MooneyRivlin, NeoHookean, StableNeoHookean, StVenantKirchhoff
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Strain, Term, Volume
from .meshes import boundary_triangles, principal_stretches, unstructured
from .problem import Problem

PATCH = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, 0.1], [0.02, 0.0, 1.03]])
SHIFT = np.array([0.3, -0.2, 0.1])
AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
ANGLES = (60, 180)
MU = 1.0
CELLS = 3

# Poisson's ratio 0.4.
LAWS: tuple[Material, ...] = (
    NeoHookean(mu=MU, lmbda=4.0 * MU),
    StableNeoHookean(mu=MU, lmbda=4.0 * MU),
    Corotated(mu=MU, lmbda=4.0 * MU),
    StVenantKirchhoff(mu=MU, lmbda=4.0 * MU),
    MooneyRivlin(C10=0.3 * MU, C01=0.2 * MU, kappa=14 / 3 * MU),
)


BOTH = {"fenicsx": 1e-12, "skfem": 1e-12}
ENERGIES: dict[str, tuple[tuple[Term, ...], dict[str, float]]] = {
    **{law.name: ((Hyperelastic(law),), BOTH) for law in LAWS},
    "Strain + Volume": ((Strain(2.0 * MU), Volume(12.0 * MU)), {"projective": 1e-8, **BOTH}),
}
"""Energies, those of projective dynamics with the same moduli at small strain, and each solver's bound."""


def held_boundary(energies: tuple[Term, ...], A: Floats) -> Scene:
    """The unit cube, its boundary held at A X + SHIFT."""
    X, tets = unstructured(CELLS)
    boundary = np.unique(boundary_triangles(tets))
    return Scene(X, tets, (*energies, Fixed(boundary, X[boundary] @ A.T + SHIFT)))


def deviation(A: Floats) -> Callable[[Scene, Solution], float]:
    """The largest distance [mm] of a vertex from A X + SHIFT."""
    return lambda scene, solution: np.linalg.norm(solution.positions - (scene.vertices @ A.T + SHIFT), axis=1).max()


def relative_energy(scene: Scene, solution: Solution) -> float:
    """The energy over mu times the rest volume."""
    return solution.energy / (MU * scene.volumes.sum())


def relative_stress(scene: Scene, solution: Solution) -> float:
    """The largest stress of a tet over Young's modulus, by the isotropic laws' linearisation: lmbda = 4 mu."""
    strain = principal_stretches(scene.vertices, solution.positions, scene.tets) - 1.0
    stress = 2.0 * MU * strain + 4.0 * MU * strain.sum(axis=1, keepdims=True)
    return float(np.abs(stress).max() / (2.8 * MU))


def near(A: Floats) -> Callable[[Scene], Floats]:
    """A start near A X + SHIFT, its vertices astray by up to a hundredth of a cell."""

    def start(scene: Scene) -> Floats:
        astray = np.random.default_rng(1).uniform(-1, 1, scene.vertices.shape) / (100 * CELLS)
        return scene.vertices @ A.T + SHIFT + astray

    return start


def problems_of(
    label: str,
    energies: tuple[Term, ...],
    bounds: dict[str, float],
) -> list[Problem]:
    """Pose the patch and rotations by ANGLES [degrees] for energies."""
    problems = [
        Problem(
            f"patch, {label}",
            "Irons and Razzaque 1972: an affine map is exact on any mesh",
            partial(held_boundary, energies, PATCH),
            deviation(PATCH),
            0.0,
            bounds,
            near(PATCH),
        )
    ]
    for angle in ANGLES:
        R = Rotation.from_rotvec(np.radians(angle) * AXIS).as_matrix()
        for name, quantity, limits in (
            ("positions", deviation(R), bounds),
            ("energy", relative_energy, dict.fromkeys(bounds, 1e-14)),
            ("stress", relative_stress, dict.fromkeys(bounds, 1e-10)),
        ):
            problems.append(
                Problem(
                    f"rotation by {angle}°, {label}, {name}",
                    "frame invariance: a rigid motion costs no energy",
                    partial(held_boundary, energies, R),
                    quantity,
                    0.0,
                    limits,
                    near(R),
                )
            )
    return problems


PROBLEMS = tuple(
    each for label, (energies, bounds) in ENERGIES.items() for each in problems_of(label, energies, bounds)
)
