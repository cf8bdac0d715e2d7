"""A manufactured solution: the body force that gives a field of one's choice, and how far off it elements are (V14).

On the unit cube, of the neo-Hookean law of Young's modulus 1 kPa and Poisson's ratio .3; the force is -Div P. The field
is u = .05 sin(πx) sin(πy) sin(πz) (1, -.5, .25).

Lagrange elements of degree k converge in L2 with order k + 1 and in H1 with k (Brenner and Scott 2008, "The
Mathematical Theory of Finite Element Methods", Chapter 5), Taylor-Hood's pressure in L2 with order 2. Theory speaks of
fine meshes: the finest two are bound to be near it, coarser ones to have an order above 0. Nearer to incompressibility,
linear and quadratic tets hold this field by locking alone: `bench mesh` has that on a head.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...lhm.base.mesh import Floats
from ..materials import NeoHookean
from ..scene import Scene
from ..solve import prepare
from ..terms import Fixed, Hyperelastic
from .meshes import block, boundary_triangles
from .problem import Outcome

LAW = NeoHookean.from_young(1.0, 0.3)
AMPLITUDE = 0.05 * np.array([1.0, -0.5, 0.25])
ERROR_DEGREE = 6


@dataclass(frozen=True)
class Errors:
    """Errors of one element on one mesh: of u in L2 [mm^(5/2)] and H1 [mm^(3/2)], of the pressure in L2, or None."""

    element: str
    cells: int
    L2: float
    H1: float
    pressure: float | None
    converged: bool
    iterations: int


def waves(X: Floats) -> tuple[Floats, Floats, Floats]:
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
    u, gradient, twice = (np.einsum("c,q...->qc...", AMPLITUDE, derivative) for derivative in (value, first, second))
    return u, gradient, twice


def body_force(X: Floats) -> Floats:
    """-Div P [mN/mm³] at places X (q, 3): P's derivative by F, times the field's second derivatives."""
    _, gradient, second = waves(X)
    F = np.eye(3) + gradient
    inverse = np.linalg.inv(F)
    log_J = np.log(np.linalg.det(F))
    pull = (LAW.mu - LAW.lmbda * log_J)[:, None, None]
    force = np.zeros((len(X), 3))
    for j in range(3):
        dF = second[:, :, :, j]
        moved = inverse @ dF
        trace = np.trace(moved, axis1=1, axis2=2)[:, None, None]
        dP = LAW.mu * dF + pull * (moved @ inverse).transpose(0, 2, 1) + LAW.lmbda * trace * inverse.transpose(0, 2, 1)
        force -= dP[:, :, j]
    return force


def errors(element: str, cells: int) -> Errors:
    """Solve on a mesh of cells³ cells and measure."""
    X, tets = block(cells)
    scene = Scene(X, tets, (Hyperelastic(LAW), Fixed(np.unique(boundary_triangles(tets)))))
    prepared: Any = prepare(scene, solver="fenicsx", element=element)
    prepared.set_body_force(body_force)
    solution = prepared.solve(tolerance=1e-9)
    at = prepared.fields(ERROR_DEGREE)
    u, gradient, _ = waves(at.X)

    def norm(difference: Floats) -> float:
        return float(np.sqrt(at.weights @ np.sum(difference.reshape(len(difference), -1) ** 2, axis=1)))

    pressure = None
    if at.pressure is not None:
        pressure = norm(at.pressure - LAW.lmbda * np.log(np.linalg.det(np.eye(3) + gradient)))
    return Errors(
        element,
        cells,
        norm(at.u - u),
        norm(at.gradient - gradient),
        pressure,
        solution.converged,
        solution.iterations,
    )


def order(coarse: Errors, fine: Errors, norm: str) -> float:
    """The order of convergence between two meshes, in the norm "L2", "H1" or "pressure"."""
    return float(np.log(getattr(coarse, norm) / getattr(fine, norm)) / np.log(fine.cells / coarse.cells))


SOURCE = "method of manufactured solutions; theory: Brenner and Scott 2008"
ORDERS = {"P1": {"L2": 2.0, "H1": 1.0}, "P2": {"L2": 3.0, "H1": 2.0}, "P2P1": {"L2": 3.0, "H1": 2.0, "pressure": 2.0}}
"""Theory's orders by element and norm."""
LEVELS = {"P1": (8, 12, 16), "P2": (4, 6, 8), "P2P1": (4, 6, 8)}
"""Cells per side of the meshes."""
SPREAD = 0.1
"""How far an order may be off theory's on the finest meshes."""


def rates(element: str, levels: tuple[int, ...] | None = None) -> list[Outcome]:
    """The order in each norm from mesh to mesh, by default of LEVELS, with its absolute error.

    On the finest meshes it is bound to be near theory's, on others to be above 0.
    """
    begin = time.perf_counter()
    measured = [errors(element, cells) for cells in levels or LEVELS[element]]
    seconds = time.perf_counter() - begin
    outcomes = []
    for coarse, fine in zip(measured, measured[1:], strict=False):
        for norm, theory in ORDERS[element].items():
            value = order(coarse, fine, norm)
            off, bound = abs(value - theory), SPREAD if fine is measured[-1] else theory
            solved = coarse.converged and fine.converged
            outcomes.append(
                Outcome(
                    f"waves, {element}, {coarse.cells} to {fine.cells} cells: order in {norm}",
                    SOURCE,
                    "fenicsx",
                    value,
                    theory,
                    off,
                    bound,
                    solved and off <= bound,
                    "CONVERGED" if solved else "not converged",
                    seconds,
                    coarse.iterations + fine.iterations,
                )
            )
    return outcomes
