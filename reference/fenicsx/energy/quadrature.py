"""Quadrature points of cells, and F there."""

from __future__ import annotations

import numpy as np

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from .. import dolfinx_version as seam
from ..mesh.numbering import Numbering

DEGREES = {1: 1, 2: 4}
"""Degree of the rule by that of the element: one point for linear tets, whose F is constant."""


class Quadrature:
    """The points of the rule of a degree on some cells (k,), q on each, cell by cell.

    `volume` [mm³], shape (k q,), is what each stands for.
    """

    def __init__(self, numbering: Numbering, cells: Ints, degree: int):
        points, weights = seam.quadrature_rule(degree)
        self.cells = cells
        self.per_cell = len(points)
        self.volume = np.outer(numbering.cell_volumes[cells], weights / weights.sum()).ravel()
        self._nodes = numbering.cell_dofs[cells]
        self._derivatives = np.ascontiguousarray(seam.shapes(numbering.degree, points)[1])
        x = numbering.X[numbering.dof[numbering.cell_vertices[cells]]]
        self._inverse = np.ascontiguousarray(np.linalg.inv((x[:, 1:] - x[:, :1]).transpose(0, 2, 1)))

    def deformation_gradient(self, u: Floats) -> Floats:
        """F at the points, shape (k q, 3, 3), of a displacement [mm] by node, shape (n, 3)."""
        return _deformation(self._nodes, self._inverse, self._derivatives, u)


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
