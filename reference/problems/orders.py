"""V14: the orders of convergence of each element on manufactured fields, by Poisson's ratio.

Lagrange elements of degree k converge in L2 with order k + 1 and in H1 with k (Brenner and Scott 2008, "The
Mathematical Theory of Finite Element Methods", Chapter 5), Taylor-Hood's pressure in L2 with order 2. Theory speaks of
fine meshes: only waves at a ratio of .3 are near it on these, and bound to be. Waves end at .45: above it, linear and
quadratic tets hold them by locking alone, and Taylor-Hood's tangent turns indefinite before all of the force is on. The
vortex keeps volume, so that there is an equilibrium for every ratio: linear tets lose their order, quadratic ones half
of it, Taylor-Hood's element none, and its error must not grow by more than a half.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from .manufactured import FIELDS, Errors, errors, order
from .problem import Outcome

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
