"""Forms whose stress and tangent are arrays at quadrature points: FEniCSx integrates, numpy supplies the law."""

from __future__ import annotations

import numpy as np
import ufl

from ...lhm.mesh import Floats, Ints
from . import dolfinx_version as seam
from .dolfinx_version import PETSc

DEGREES = {1: 1, 2: 4}
"""Degree of the rule by that of the element: one point for linear tets, whose F is constant."""


class QuadratureForms:
    """F at the quadrature points of some cells, and the assembly of P and dP/dF given there.

    Points are those of the rule of a degree, cell by cell; `volume` [mm³], shape (k q,), is what each stands for.
    """

    def __init__(self, displacement, cells: Ints, cell_volumes: Floats, degree: int = 1):
        space = displacement.function_space
        domain = space.mesh
        points, weights = seam.quadrature_rule(degree)
        self.cells = cells
        self.points = points
        self.per_cell = len(points)
        self.volume = np.outer(cell_volumes[cells], weights / weights.sum()).ravel()
        self._gradient_at = seam.evaluator(ufl.grad(displacement), points, domain)

        stress_space = seam.quadrature_space(domain, degree, (3, 3))
        self._stress = seam.function(stress_space)
        self._stress_dofs = seam.cell_dofs(stress_space, self.per_cell)[cells].ravel()
        tangent_space = seam.quadrature_space(domain, degree, (9, 9))
        self._tangent = seam.function(tangent_space)
        self._tangent_dofs = seam.cell_dofs(tangent_space, self.per_cell)[cells].ravel()

        dx = seam.cell_measure(domain, cells)(metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})
        v, du = ufl.TestFunction(space), ufl.TrialFunction(space)
        self._linear = seam.compile_form(ufl.inner(self._stress, ufl.grad(v)) * dx)
        self._bilinear = seam.compile_form(ufl.inner(ufl.dot(self._tangent, _flat(du)), _flat(v)) * dx)

    def deformation_gradient(self) -> Floats:
        """F at the points, shape (k q, 3, 3), for the displacement's present values."""
        return self._gradient_at(self.cells).reshape(-1, 3, 3) + np.eye(3)

    def add_gradient(self, P: Floats, into: Floats):
        """Add the integral of P : grad v [mN], P [kPa] of shape (k q, 3, 3), to an array of dofs (3n,)."""
        self._stress.x.array.reshape(-1, 9)[self._stress_dofs] = P.reshape(-1, 9)
        seam.add_vector(self._linear, into)

    def add_tangent(self, C: Floats, into: PETSc.Mat):
        """Add the integral of grad v : C : grad u [mN/mm], C [kPa] of shape (k q, 9, 9), to a matrix."""
        self._tangent.x.array.reshape(-1, 81)[self._tangent_dofs] = C.reshape(-1, 81)
        seam.add_matrix(self._bilinear, into)


def _flat(v):
    """The gradient of v as a vector of nine, row by row."""
    gradient = ufl.grad(v)
    return ufl.as_vector([gradient[i, j] for i in range(3) for j in range(3)])
