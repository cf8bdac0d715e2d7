"""H4: flat layers and slivers, which must not spoil a homogeneous stretch: the unit cube of V2 with bad tets in it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Ints, tet_volumes
from . import homogeneous, stretched_laws
from .hard_case import Attempt, HardCase
from .homogeneous import Row, held
from .meshes import block

CELLS = 3
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
    (homogeneous.STRAIN_ROWS[3], ALL, ("P1", "P2")),
    (homogeneous.NEO_HOOKEAN_ROWS[1], NEWTON, MIXED),
    (stretched_laws.corotated(1.5, 1), NEWTON, ("P1", "P2")),
    (stretched_laws.kirchhoff(1.2), NEWTON, MIXED),
    *((row, NEWTON, MIXED) for row in stretched_laws.SOLVED_ROWS if row.loaded == 1 and row.stretch == 2.0),
    (stretched_laws.FIBRE_ROWS[0], ("fenicsx",), MIXED),
)


def position_error(row: Row, mesh: Mesh, attempt: Attempt) -> float:
    """The largest distance [mm] of a vertex from the homogeneous stretch."""
    scene = held(row, mesh())
    exact = scene.vertices * [row.stretch, row.free_stretch, row.free_stretch]
    start = scene.vertices * [row.stretch, 1.0, 1.0]
    found = attempt.solve(attempt.prepare(scene), start=start, tolerance=TOLERANCE).positions
    return float(np.linalg.norm(found - exact, axis=1).max())


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
