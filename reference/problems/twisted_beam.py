"""A slender beam turned up to four times at one end: the benchmark of Béreš and Valdman, energies of their codes.

"Minimization of nonlinear energies in Python using FEM and automatic differentiation tools" (PPAM 2024) gives the
energy of 24 steps to four digits, on three meshes of linear tets, which are Kuhn's. The beam leaves its axis on the
way. Here each is one solve, from a bent beam: from a straight one the coarsest mesh may take hundreds of iterations at
four turns, where the energy is nearly flat. Their codes on FEniCSx, which stop at larger gradients, are there up to
0.03 J above the value by JAX that stands here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ...lhm.base.mesh import Floats
from ..materials import EnergyLaw
from ..materials.material import LameLaw
from ..scene import Scene
from ..terms import Fixed, Hyperelastic
from .meshes import box, twist, vertices_at
from .problem import Problem, energy

SOURCE = "published: Béreš and Valdman 2024, by JAX"
LENGTH, WIDTH = 400.0, 10.0
"""[mm]"""
MU, BULK = 2e5 / 2.6, 2e5 / 1.2
"""[kPa], of Young's modulus 200 MPa and Poisson's ratio 0.3."""
TURN = 2.0 * np.pi
JOULE = 1e6
"""[µJ]"""
ROUNDING = 5e-5
"""Half of the energies' last digit [J]."""


@dataclass(frozen=True)
class SquaredVolume(LameLaw, EnergyLaw):
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 (J - 1)²; mu and lmbda [kPa]. Infinite for J <= 0."""

    def density(self, I1: Any, I2: Any, J: Any, p: Any, m: Any) -> Any:
        return p.mu / 2 * (I1 - 3) - p.mu * m.log(J) + p.lmbda / 2 * (J - 1) ** 2


def turned_beam(turns: float, cells: int) -> Scene:
    """The beam of so many cells across, one end held and the other turned."""
    X, tets = box((40 * cells, cells, cells), (LENGTH, WIDTH, WIDTH))
    ends = np.concatenate([vertices_at(X, 0, 0.0), vertices_at(X, 0, LENGTH)])
    return Scene(X, tets, (Hyperelastic(SquaredVolume(MU, BULK)), Fixed(ends, twist(X, TURN * turns)[ends])))


def bend(turns: float, X: Floats) -> Floats:
    """Positions [mm] of the beam turned evenly, its axis a helix of one turn, a beam's width away at the middle."""
    share = X[:, 0] / LENGTH
    away = WIDTH * np.sin(np.pi * share)
    helix = away * np.cos(TURN * share), away * np.sin(TURN * share)
    return twist(X, TURN * turns) + np.column_stack([np.zeros(len(X)), *helix])


def _problem(turns: int, cells: int, joules: float, solvers: tuple[str, ...] = ("fenicsx", "skfem")) -> Problem:
    return Problem(
        f"beam turned {turns} times, {cells} cells across: energy",
        SOURCE,
        partial(turned_beam, turns, cells),
        energy,
        joules * JOULE,
        dict.fromkeys(solvers, ROUNDING / joules),
        start=lambda scene: bend(turns, scene.vertices),
        tolerance=1e-10,
    )


PROBLEMS = (_problem(2, 2, 49.5501), _problem(3, 2, 111.3262), _problem(4, 2, 197.7484))
FINE = (_problem(4, 4, 116.3232, ("fenicsx",)), _problem(4, 8, 93.7039, ("fenicsx",)))
