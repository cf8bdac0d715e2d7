"""A solution as finite-element functions: displacement, its gradient and the pressure inside the tets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.mesh import Floats
from . import dolfinx_version as seam
from .numbering import Numbering
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
    """Shape functions of a numbering's nodes at the points of a rule."""

    def __init__(self, order: Numbering, degree: int):
        points, weights = seam.quadrature_rule(degree)
        self._order = order
        corners = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        x = order.X[order.dof[order.cell_vertices]]
        self._jacobian = x.transpose(0, 2, 1) @ np.linalg.pinv(corners - corners.mean(axis=0)).T
        self.X = (seam.shapes(1, points)[0] @ x).reshape(-1, 3)
        self.weights = np.outer(np.abs(np.linalg.det(self._jacobian)), weights).ravel()
        self._values, self._derivatives = seam.shapes(order.degree, points)
        self._linear = seam.shapes(1, points)[0]

    def load(self, density: Floats) -> Floats:
        """Nodal forces, a vector (owned, 3), of a force per volume at the points here, shape (q, 3)."""
        weighted = (density * self.weights[:, None]).reshape(len(self._jacobian), -1, 3)
        parts = np.einsum("qk,mqc->mkc", self._values, weighted)
        result = np.zeros(self._order.X.shape)
        for c in range(3):
            result[:, c] = np.bincount(self._order.cell_dofs.ravel(), parts[:, :, c].ravel(), minlength=len(result))
        return self._order.nodes.summed(result)

    def fields(self, u: Floats, pressure: Floats | None) -> Fields:
        """Nodal displacements (n, 3) and pressures, shape (cells, 4), at the points of all processes."""
        nodal = u[self._order.cell_dofs]
        local = np.einsum("mkc,qkd->mqcd", nodal, self._derivatives)
        gradient = local @ np.linalg.inv(self._jacobian)[:, None]
        at_points = (self._values @ nodal).reshape(-1, 3)
        X, weights, displacement, by_place = (
            gathered(self._order.comm, values)
            for values in (self.X, self.weights, at_points, gradient.reshape(-1, 3, 3))
        )
        pressures = None if pressure is None else gathered(self._order.comm, (pressure @ self._linear.T).ravel())
        return Fields(X, weights, displacement, by_place, pressures)
