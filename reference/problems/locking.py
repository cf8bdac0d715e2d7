"""Poisson's ratio towards one half on Cook's membrane: which elements lock, and how much.

The limit for each ratio is that of Taylor-Hood's element on a finer mesh. Projective dynamics' energies have the same
moduli at small strain; their minimum on linear tets, which its iteration converges to, is found by Newton here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

from ..materials import Volumetric
from ..scene import Scene
from ..solve import solve
from ..terms import Hyperelastic, Strain, Volume
from .cook import MIDDLE, cook, law, rise
from .problem import Outcome

POISSON = (0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999)
MU, TRACTION = 80.194, 6.25
TOLERANCE = 1e-8
NEAR_LIMIT = 5e-3
SOURCE = "method: the same panel by Taylor-Hood's element on a finer mesh"


@dataclass(frozen=True)
class Locking:
    """The rise [mm] of the loaded edge's middle, and its share of the limit; `converged` says whether it was found."""

    poisson: float
    element: str
    cells: int
    rise: float
    share: float
    converged: bool
    seconds: float
    iterations: int


def panel(poisson: float, cells: int) -> Scene:
    """Cook's membrane of one shear modulus at a Poisson's ratio."""
    return cook(law(MU, poisson, Volumetric.QUADRATIC), TRACTION, cells)


def by_projective_energies(scene: Scene, poisson: float) -> Scene:
    """The scene with Strain and Volume of the same moduli at small strain in the law's place."""
    lmbda = 2 * MU * poisson / (1 - 2 * poisson)
    others = [term for term in scene.terms if not isinstance(term, Hyperelastic)]
    return replace(scene, terms=(Strain(2 * MU), Volume(3 * lmbda), *others))


def sweep(poisson: float, cells: int, finer: int) -> list[Locking]:
    """P2P1, P1 and projective dynamics' energies on `cells`² cells, against P2P1 on `finer`²."""
    scene = panel(poisson, cells)
    cases = [
        ("P2P1", panel(poisson, finer), finer, "P2P1"),
        ("P2P1", scene, cells, "P2P1"),
        ("P1", scene, cells, "P1"),
        ("PD energies on P1", by_projective_energies(scene, poisson), cells, "P1"),
    ]
    rows: list[Locking] = []
    for name, posed, n, element in cases:
        options: dict[str, Any] = {"linear_solver": "mumps"} if element == "P1" else {}
        begin = time.perf_counter()
        solution = solve(posed, solver="fenicsx", element=element, tolerance=TOLERANCE, **options)
        value = rise(MIDDLE, posed, solution)
        limit = rows[0].rise if rows else value
        rows.append(
            Locking(
                poisson,
                name,
                n,
                value,
                value / limit,
                solution.converged,
                time.perf_counter() - begin,
                solution.iterations,
            )
        )
    return rows


def outcomes(poisson: float, cells: int = 16, finer: int = 24) -> list[Outcome]:
    """The shares of the limit; only Taylor-Hood's is bound to be right."""
    found = []
    for row in sweep(poisson, cells, finer)[1:]:
        bound = NEAR_LIMIT if row.element == "P2P1" else 1.0
        name = f"locking, nu={poisson:g}, {row.element}, {cells} cells: share of the limit"
        reason = "CONVERGED" if row.converged else "not converged"
        off = abs(row.share - 1.0)
        passed = row.converged and off <= bound
        found.append(
            Outcome(name, SOURCE, "fenicsx", row.share, 1.0, off, bound, passed, reason, row.seconds, row.iterations)
        )
    return found
