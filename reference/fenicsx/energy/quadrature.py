"""Quadrature points of cells: F there, and the stiffness of laws whose dP/dF is known there as arrays.

Mesh, nodes, rule and shape functions are FEniCSx'; the loops over points are compiled.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ....lhm.base.mesh import Floats, Ints
from .. import dolfinx_version as seam
from ..mesh.numbering import Numbering
from .assembly import Stiffness, place_of

DEGREES = {1: 1, 2: 4}
"""Degree of the rule by that of the element: one point for linear tets, whose F is constant."""


class Quadrature:
    """The points of the rule of a degree on some cells (k,), q on each, cell by cell.

    `volume` [mm³], shape (k q,), is what each stands for.
    """

    def __init__(self, order: Numbering, cells: Ints, degree: int):
        points, weights = seam.quadrature_rule(degree)
        self.cells = cells
        self.per_cell = len(points)
        self.volume = np.outer(order.cell_volumes[cells], weights / weights.sum()).ravel()
        self._nodes = order.cell_dofs[cells]
        self._derivatives = np.ascontiguousarray(seam.shapes(order.degree, points)[1])
        x = order.X[order.dof[order.cell_vertices[cells]]]
        self._inverse = np.ascontiguousarray(np.linalg.inv((x[:, 1:] - x[:, :1]).transpose(0, 2, 1)))
        self._slots: Ints | None = None

    def deformation_gradient(self, u: Floats) -> Floats:
        """F at the points, shape (k q, 3, 3), of a displacement [mm] by node, shape (n, 3)."""
        return _deformation(self._nodes, self._inverse, self._derivatives, u)

    def add_tangent(self, points: Ints, C: Floats, into: Stiffness):
        """Add the integral of grad v : dP/dF : grad u [mN/mm], dP/dF [kPa] (p, 9, 9) at some of the points (p,)."""
        _add_tangent(self._nodes, self._inverse, self._derivatives, self.volume, points, C, *self._where(into))
        into.touch()

    def _where(self, into: Stiffness) -> tuple[Ints, Ints, Floats]:
        if self._slots is None:
            self._slots = into.slots(self._nodes)
        return into.starts, self._slots, into.values


@njit(inline="always")
def _shape_gradients(derivatives, inverse, gradients):
    """Gradients in space (k, 3) of the shape functions, from those on the reference cell."""
    for a in range(len(derivatives)):
        for j in range(3):
            gradients[a, j] = (
                derivatives[a, 0] * inverse[0, j]
                + derivatives[a, 1] * inverse[1, j]
                + derivatives[a, 2] * inverse[2, j]
            )


@njit(cache=True)
def _deformation(nodes, inverse, derivatives, u):
    m, k = nodes.shape
    q = len(derivatives)
    F = np.empty((m * q, 3, 3))
    H = np.empty((3, 3))
    for e in range(m):
        for p in range(q):
            H[:] = 0.0
            for a in range(k):
                node = nodes[e, a]
                for i in range(3):
                    for j in range(3):
                        H[i, j] += u[node, i] * derivatives[p, a, j]
            for i in range(3):
                for j in range(3):
                    moved = H[i, 0] * inverse[e, 0, j] + H[i, 1] * inverse[e, 1, j] + H[i, 2] * inverse[e, 2, j]
                    F[e * q + p, i, j] = moved + (1.0 if i == j else 0.0)
    return F


@njit(inline="always")
def _add_pairs(local, nodes, starts, slots, values):
    """Add the blocks of pairs a < b, those of b and a, and on the diagonal what makes translations free of forces."""
    k = len(nodes)
    for a in range(k):
        for b in range(a + 1, k):
            ab, width_a = place_of(starts, nodes[a], slots[a, b])
            ba, width_b = place_of(starts, nodes[b], slots[b, a])
            aa, _ = place_of(starts, nodes[a], slots[a, a])
            bb, _ = place_of(starts, nodes[b], slots[b, b])
            for i in range(3):
                for j in range(3):
                    value = local[a, b, i, j]
                    values[ab + i * width_a + j] += value
                    values[ba + j * width_b + i] += value
                    values[aa + i * width_a + j] -= value
                    values[bb + j * width_b + i] -= value


@njit(cache=True)
def _add_tangent(nodes, inverse, derivatives, volume, points, C, starts, slots, values):
    k, q = nodes.shape[1], len(derivatives)
    gradients, local, CB = np.empty((k, 3)), np.empty((k, k, 3, 3)), np.empty((9, 3))
    for n in range(len(points)):
        at = points[n]
        e = at // q
        _shape_gradients(derivatives[at - e * q], inverse[e], gradients)
        for b in range(k):
            for row in range(9):
                for j in range(3):
                    CB[row, j] = volume[at] * (
                        C[n, row, 3 * j] * gradients[b, 0]
                        + C[n, row, 3 * j + 1] * gradients[b, 1]
                        + C[n, row, 3 * j + 2] * gradients[b, 2]
                    )
            for a in range(b):
                for i in range(3):
                    for j in range(3):
                        local[a, b, i, j] = (
                            gradients[a, 0] * CB[3 * i, j]
                            + gradients[a, 1] * CB[3 * i + 1, j]
                            + gradients[a, 2] * CB[3 * i + 2, j]
                        )
        _add_pairs(local, nodes[e], starts, slots[e], values)
