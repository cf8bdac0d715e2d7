"""A solution as finite-element functions: displacement, its gradient and the pressure inside the tets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats
from . import dolfinx_version as seam
from .assembly import add_forces
from .numbering import Numbering
from .quadrature import Quadrature
from .shared import gathered


@dataclass(frozen=True, eq=False)
class Fields:
    """Values at quadrature points (q,): rest places X [mm] (q, 3), weights [mm³] (q,), u [mm] (q, 3), grad u (q, 3, 3).

    `pressure` [kPa] is (q,), or None for an element without one.
    """

    X: Floats
    weights: Floats
    u: Floats
    gradient: Floats
    pressure: Floats | None


class Sampling:
    """Shape functions of a numbering's nodes at the points of a rule, on all cells of this process."""

    def __init__(self, order: Numbering, degree: int):
        points, _ = seam.quadrature_rule(degree)
        self._order, self._quadrature = order, Quadrature(order, np.arange(len(order.cell_dofs)), degree)
        self._linear, self._values = (seam.shapes(of, points)[0] for of in (1, order.degree))
        self.X = (self._linear @ order.X[order.dof[order.cell_vertices]]).reshape(-1, 3)

    def load(self, density: Floats) -> Floats:
        """Nodal forces, a vector (owned, 3), of a force per volume at the points here, shape (q, 3)."""
        nodes = self._order.cell_dofs
        weighted = (density * self._quadrature.volume[:, None]).reshape(len(nodes), -1, 3)
        result = np.zeros(self._order.X.shape)
        add_forces(nodes, np.einsum("qk,mqc->mkc", self._values, weighted), result)
        return self._order.nodes.summed(result)

    def fields(self, u: Floats, pressure: Floats | None) -> Fields:
        """Nodal displacements (n, 3) and pressures, shape (cells, 4), at the points of all processes."""
        at_points = (self._values @ u[self._order.cell_dofs]).reshape(-1, 3)
        gradient = self._quadrature.deformation_gradient(u) - np.eye(3)
        X, weights, displacement, by_place = (
            gathered(self._order.comm, values) for values in (self.X, self._quadrature.volume, at_points, gradient)
        )
        pressures = None if pressure is None else gathered(self._order.comm, (pressure @ self._linear.T).ravel())
        return Fields(X, weights, displacement, by_place, pressures)
