"""Forms whose stress and tangent are arrays at quadrature points: FEniCSx integrates, numpy supplies the law."""

from __future__ import annotations

from functools import cached_property
from typing import Any

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
        self._space, self._degree = space, degree
        self._dx = seam.cell_measure(domain, cells)(
            metadata={"quadrature_degree": degree, "quadrature_scheme": "default"}
        )

    @cached_property
    def _stress(self) -> tuple[Any, Ints, Any]:
        """A function of stresses, its dofs at the points, and the form that integrates it."""
        stress, dofs = self._tensor((3, 3))
        form = ufl.inner(stress, ufl.grad(ufl.TestFunction(self._space))) * self._dx
        return stress, dofs, seam.compile_form(form)

    @cached_property
    def _tangent(self) -> tuple[Any, Ints, Any]:
        tangent, dofs = self._tensor((9, 9))
        v, du = ufl.TestFunction(self._space), ufl.TrialFunction(self._space)
        form = ufl.inner(ufl.dot(tangent, _flat(du)), _flat(v)) * self._dx
        return tangent, dofs, seam.compile_form(form)

    def _tensor(self, shape: tuple[int, int]) -> tuple[Any, Ints]:
        space = seam.quadrature_space(self._space.mesh, self._degree, shape)
        return seam.function(space), seam.cell_dofs(space, self.per_cell)[self.cells].ravel()

    def deformation_gradient(self) -> Floats:
        """F at the points, shape (k q, 3, 3), for the displacement's present values."""
        return self._gradient_at(self.cells).reshape(-1, 3, 3) + np.eye(3)

    def add_gradient(self, P: Floats, into: Floats):
        """Add the integral of P : grad v [mN], P [kPa] of shape (k q, 3, 3), to an array of dofs (3n,)."""
        stress, dofs, form = self._stress
        stress.x.array.reshape(-1, 9)[dofs] = P.reshape(-1, 9)
        seam.add_vector(form, into)

    def add_tangent(self, C: Floats, into: PETSc.Mat):
        """Add the integral of grad v : C : grad u [mN/mm], C [kPa] of shape (k q, 9, 9), to a matrix."""
        tangent, dofs, form = self._tangent
        tangent.x.array.reshape(-1, 81)[dofs] = C.reshape(-1, 81)
        seam.add_matrix(form, into)


def _flat(v):
    """The gradient of v as a vector of nine, row by row."""
    gradient = ufl.grad(v)
    return ufl.as_vector([gradient[i, j] for i in range(3) for j in range(3)])
