"""Manufactured solutions: the body force that gives a field of one's choice, and how far off it elements are (V14).

On the unit cube, of the neo-Hookean law of Young's modulus 1 kPa; the force is -Div P. The first field,
u = .05 sin(πx) sin(πy) sin(πz) (1, -.5, .25), changes volume, so its pressure lmbda ln J grows with lmbda, and with it
the error of any element whose displacement is not independent of the pressure, Taylor-Hood's included. The second, a
vortex that turns circles about the middle axis, keeps every volume: what is left is how an element bears lmbda itself.

Lagrange elements of degree k converge in L2 with order k + 1 and in H1 with k (Brenner and Scott 2008, "The
Mathematical Theory of Finite Element Methods", Chapter 5), Taylor-Hood's pressure in L2 with order 2. Theory speaks of
fine meshes: only waves at a ratio of .3 are near it on these, and bound to be. Waves end at .45: above it, linear and
quadratic tets hold them by locking alone, and Taylor-Hood's tangent turns indefinite before all of the force is on. The
vortex keeps volume, so that there is an equilibrium for every ratio: linear tets lose their order, quadratic ones half
of it, Taylor-Hood's element none, and its error must not grow by more than a half.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
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

TURN = 0.6
AMPLITUDE = 0.05 * np.array([1.0, -0.5, 0.25])
ERROR_DEGREE = 6

Field = Callable[[Floats], tuple[Floats, Floats, Floats]]
"""u (q, 3), its gradient (q, 3, 3) and second derivatives (q, 3, 3, 3) at places X (q, 3)."""


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


def vortex(X: Floats) -> tuple[Floats, Floats, Floats]:
    """The same of a turn by TURN (1 - 4 r²)⁴ sin²(πz) about the axis x = y = 1/2, within r < 1/2; J is 1."""
    d = (X - 0.5) * [1.0, 1.0, 0.0]
    near = np.maximum(1.0 - 4.0 * np.sum(d**2, axis=1), 0.0)
    # The angle is radial times axial, with their derivatives by r² and by z.
    radial, by_square, by_squares = near**4, -16.0 * near**3, 192.0 * near**2
    axial = np.sin(np.pi * X[:, 2]) ** 2
    by_z, by_zz = np.pi * np.sin(2 * np.pi * X[:, 2]), 2 * np.pi**2 * np.cos(2 * np.pi * X[:, 2])
    plane, up = np.diag([1.0, 1.0, 0.0]), np.eye(3)[2]
    angle = TURN * radial * axial
    first = TURN * ((2 * by_square * axial)[:, None] * d + (radial * by_z)[:, None] * up)
    outer = d[:, :, None] * d[:, None, :]
    mixed = d[:, :, None] * up
    second = TURN * (
        (4 * by_squares * axial)[:, None, None] * outer
        + (2 * by_square * axial)[:, None, None] * plane
        + (2 * by_square * by_z)[:, None, None] * (mixed + mixed.transpose(0, 2, 1))
        + (radial * by_zz)[:, None, None] * np.outer(up, up)
    )
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(X))
    R = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero]]).transpose(2, 0, 1)
    dR = np.array([[-s, -c, zero], [c, -s, zero], [zero, zero, zero]]).transpose(2, 0, 1)
    turned, ahead = np.einsum("qij,qj->qi", R, d), np.einsum("qij,qj->qi", dR, d)
    gradient = np.einsum("qc,qi->qci", ahead, first) + R - plane
    along = np.einsum("qci,qj->qcij", dR @ plane, first)
    twice = (
        np.einsum("qc,qij->qcij", ahead, second)
        - np.einsum("qc,qi,qj->qcij", turned, first, first)
        + along
        + along.transpose(0, 1, 3, 2)
    )
    return turned - d, gradient, twice


FIELDS: dict[str, Field] = {"waves": waves, "vortex": vortex}


def body_force(field: Field, law: NeoHookean, X: Floats) -> Floats:
    """-Div P [mN/mm³] of a field at places X (q, 3): P's derivative by F, times the field's second derivatives."""
    _, gradient, second = field(X)
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


def errors(field: Field, element: str, poisson: float, cells: int) -> Errors:
    """Solve on a mesh of cells³ cells and measure."""
    law = NeoHookean.from_young(1.0, poisson)
    X, tets = block(cells)
    scene = Scene(X, tets, (Hyperelastic(law), Fixed(np.unique(boundary_triangles(tets)))))
    prepared: Any = prepare(scene, solver="fenicsx", element=element)
    prepared.set_body_force(lambda places: body_force(field, law, places))
    solution = prepared.solve(tolerance=1e-9)
    at = prepared.fields(ERROR_DEGREE)
    u, gradient, _ = field(at.X)

    def norm(difference: Floats) -> float:
        return float(np.sqrt(at.weights @ np.sum(difference.reshape(len(difference), -1) ** 2, axis=1)))

    pressure = None
    if at.pressure is not None:
        pressure = norm(at.pressure - law.lmbda * np.log(np.linalg.det(np.eye(3) + gradient)))
    return Errors(
        element,
        poisson,
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
"""How far an order may be off theory's, where it is bound to be near it."""
GROWTH = 0.5
"""How much Taylor-Hood's error may grow, relative to that at a ratio of .3."""
STUDIES = (
    ("waves", 0.3),
    ("waves", 0.45),
    ("vortex", 0.3),
    ("vortex", 0.45),
    ("vortex", 0.49),
    ("vortex", 0.4999),
)
"""Fields and Poisson's ratios."""
NEAR_THEORY = STUDIES[0]


def _outcome(name: str, value: float, reference: float, bound: float, measured: tuple[Errors, ...], seconds: float):
    solved = all(error.converged for error in measured)
    off = abs(value - reference)
    return Outcome(
        name,
        SOURCE,
        "fenicsx",
        value,
        reference,
        off,
        bound,
        solved and off <= bound,
        "CONVERGED" if solved else "not converged",
        seconds,
        sum(error.iterations for error in measured),
    )


def rates(element: str, field: str, poisson: float, levels: tuple[int, ...]) -> tuple[list[Outcome], Errors]:
    """The order in each norm from mesh to mesh, with its absolute error, and the errors on the finest mesh.

    The last is bound to be near theory's where NEAR_THEORY; all others, to be above 0 at least.
    """
    begin = time.perf_counter()
    measured = [errors(FIELDS[field], element, poisson, cells) for cells in levels]
    seconds = time.perf_counter() - begin
    outcomes = []
    for coarse, fine in zip(measured, measured[1:], strict=False):
        for norm, theory in ORDERS[element].items():
            near = (field, poisson) == NEAR_THEORY and fine is measured[-1]
            name = f"{field}, nu={poisson:g}, {element}, {coarse.cells} to {fine.cells} cells: order in {norm}"
            value = order(coarse, fine, norm)
            outcomes.append(_outcome(name, value, theory, SPREAD if near else theory, (coarse, fine), seconds))
    return outcomes, measured[-1]


def study(element: str) -> Iterator[Outcome]:
    """Orders of an element in all STUDIES; of Taylor-Hood's, the vortex' errors relative to those at a ratio of .3."""
    first: Errors | None = None
    for field, poisson in STUDIES:
        outcomes, finest = rates(element, field, poisson, LEVELS[element])
        yield from outcomes
        if element != "P2P1" or field != "vortex":
            continue
        first = first or finest
        for norm in ("L2", "H1"):
            name = f"vortex, nu={poisson:g}, P2P1, {finest.cells} cells: error in {norm} over that at nu=.3"
            ratio = getattr(finest, norm) / getattr(first, norm)
            yield _outcome(name, ratio, 1.0, GROWTH, (finest,), outcomes[0].seconds)
