"""A manufactured solution: the body force that gives a field of one's choice, and the rates at which elements find it.

u = .05 sin(πx) sin(πy) sin(πz) (1, -.5, .25) on the unit cube, of the neo-Hookean law of Young's modulus 1 kPa; the
force is -Div P. Lagrange elements of degree k converge in L2 with order k + 1 and in H1 with k (Brenner and Scott 2008,
"The Mathematical Theory of Finite Element Methods", Chapter 5), Taylor-Hood's pressure in L2 with order 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.mesh import Floats
from ..materials import NeoHookean
from ..scene import Scene
from ..solve import prepare
from ..terms import Fixed, Hyperelastic
from .meshes import block, boundary_triangles

SOURCE = "method of manufactured solutions; theory: Brenner and Scott 2008"
AMPLITUDE = 0.05 * np.array([1.0, -0.5, 0.25])
ORDERS = {"P1": {"L2": 2.0, "H1": 1.0}, "P2": {"L2": 3.0, "H1": 2.0}, "P2P1": {"L2": 3.0, "H1": 2.0, "pressure": 2.0}}
"""Theory's orders by element and norm."""
ERROR_DEGREE = 6


@dataclass(frozen=True)
class Errors:
    """Errors of one element on one mesh: of u in L2 [mm^(5/2)] and H1 [mm^(3/2)], of the pressure in L2, or None."""

    element: str
    poisson: float
    cells: int
    L2: float
    H1: float
    pressure: float | None
    converged: bool
    iterations: int


def displacement(X: Floats) -> tuple[Floats, Floats, Floats]:
    """U (q, 3), its gradient (q, 3, 3) and second derivatives (q, 3, 3, 3) at places X (q, 3)."""
    s, c = np.sin(np.pi * X), np.cos(np.pi * X)
    value = s.prod(axis=1)
    first, second = np.empty((len(X), 3)), np.empty((len(X), 3, 3))
    for i in range(3):
        factors = np.array(s)
        factors[:, i] = np.pi * c[:, i]
        first[:, i] = factors.prod(axis=1)
        for j in range(3):
            twice = np.array(factors)
            twice[:, j] = np.pi * c[:, j] if i != j else -(np.pi**2) * s[:, j]
            second[:, i, j] = twice.prod(axis=1)
    return tuple(np.einsum("c,q...->qc...", AMPLITUDE, derivative) for derivative in (value, first, second))


def body_force(law: NeoHookean, X: Floats) -> Floats:
    """-Div P [mN/mm³] of the field at places X (q, 3): P's derivative by F, times the field's second derivatives."""
    _, gradient, second = displacement(X)
    F = np.eye(3) + gradient
    inverse = np.linalg.inv(F)
    log_J = np.log(np.linalg.det(F))
    pull = (law.mu - law.lmbda * log_J)[:, None, None]
    force = np.zeros((len(X), 3))
    for j in range(3):
        dF = second[:, :, :, j]
        moved = inverse @ dF
        trace = np.trace(moved, axis1=1, axis2=2)[:, None, None]
        dP = law.mu * dF + pull * (moved @ inverse).transpose(0, 2, 1) + law.lmbda * trace * inverse.transpose(0, 2, 1)
        force -= dP[:, :, j]
    return force


def errors(element: str, poisson: float, cells: int, tolerance: float = 1e-9) -> Errors:
    """Solve on a mesh of cells³ cells and measure."""
    law = NeoHookean.from_young(1.0, poisson)
    X, tets = block(cells)
    scene = Scene(X, tets, [Hyperelastic(law), Fixed(np.unique(boundary_triangles(tets)))])
    prepared = prepare(scene, solver="fenicsx", element=element)
    prepared.set_body_force(lambda places: body_force(law, places))
    solution = prepared.solve(tolerance=tolerance)
    found = prepared.fields(ERROR_DEGREE)
    u, gradient, _ = displacement(found.X)

    def norm(difference: Floats) -> float:
        return float(np.sqrt(found.weights @ np.sum(difference.reshape(len(difference), -1) ** 2, axis=1)))

    pressure = None
    if found.pressure is not None:
        pressure = norm(found.pressure - law.lmbda * np.log(np.linalg.det(np.eye(3) + gradient)))
    return Errors(
        element,
        poisson,
        cells,
        norm(found.u - u),
        norm(found.gradient - gradient),
        pressure,
        solution.converged,
        solution.iterations,
    )


def order(coarse: Errors, fine: Errors, norm: str) -> float:
    """The order of convergence between two meshes, in the norm "L2", "H1" or "pressure"."""
    return float(np.log(getattr(coarse, norm) / getattr(fine, norm)) / np.log(fine.cells / coarse.cells))
