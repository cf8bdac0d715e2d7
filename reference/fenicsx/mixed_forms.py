"""Forms of a law with an independent pressure: HyperelasticForms and what the pressure adds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl

from ...lhm.mesh import Floats, Ints
from ..materials import Incompressible, Material
from . import dolfinx_version as seam
from .dolfinx_version import PETSc
from .hyperelastic import HyperelasticForms, elastic_part, stress_and_tangent, symbols
from .mixed_densities import mixed_density


@dataclass(frozen=True, eq=False)
class MixedForms(HyperelasticForms):
    """Forms of displacement and pressure on some cells.

    By the pressure [kPa]: the gradient [mm³], by displacement and pressure the coupling [mm²], and by the pressure
    twice the compliance, negative semi-definite [mm³/kPa].
    """

    by_pressure: Any
    coupling: tuple[Any, PETSc.Mat]
    compliance: tuple[Any, PETSc.Mat]

    @classmethod
    def of_both(
        cls, displacement, pressure, cells: Ints, material: Material, degree: int, growth: Floats | float = 1.0
    ) -> MixedForms:
        """Forms for displacement [mm] and pressure [kPa] on cells (k,), by the quadrature rule of a degree."""
        space, pressures = displacement.function_space, pressure.function_space
        domain = space.mesh
        law = material.law if isinstance(material, Incompressible) else material
        F = ufl.variable(ufl.Identity(3) + ufl.grad(displacement))
        elastic, ratio = elastic_part(F, growth, domain, cells)
        psi = ratio * mixed_density(elastic, pressure, material, symbols(law, domain, cells))
        energy = psi * seam.cell_measure(domain, cells)(metadata={"quadrature_degree": degree})
        gradient = ufl.derivative(energy, displacement, ufl.TestFunction(space))
        tangent = ufl.derivative(gradient, displacement, ufl.TrialFunction(space))
        by_pressure = ufl.derivative(energy, pressure, ufl.TestFunction(pressures))
        coupling = ufl.derivative(gradient, pressure, ufl.TrialFunction(pressures))
        compliance = ufl.derivative(by_pressure, pressure, ufl.TrialFunction(pressures))
        return cls(
            cells,
            seam.compile_form(energy),
            seam.compile_form(gradient),
            seam.compile_form(tangent),
            *stress_and_tangent(psi, F, degree, domain),
            seam.compile_form(by_pressure),
            _with_matrix(coupling),
            _with_matrix(compliance),
        )

    def add_by_pressure(self, into: Floats):
        """Add the gradient by the pressure to an array (n_p,)."""
        seam.add_vector(self.by_pressure, into)

    def entries(self) -> tuple[tuple[Ints, Ints, Floats], tuple[Ints, Ints, Floats]]:
        """Rows, columns and values of the coupling (3n, n_p) and of the compliance (n_p, n_p)."""
        return _entries(*self.coupling), _entries(*self.compliance)


def _with_matrix(form: ufl.Form) -> tuple[Any, PETSc.Mat]:
    compiled = seam.compile_form(form)
    return compiled, seam.empty_matrix(compiled)


def _entries(form, matrix: PETSc.Mat) -> tuple[Ints, Ints, Floats]:
    matrix.zeroEntries()
    seam.add_matrix(form, matrix)
    matrix.assemble()
    return matrix_entries(matrix)


def matrix_entries(matrix: PETSc.Mat) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and values of a matrix, its stored zeros included."""
    indptr, columns, values = matrix.getValuesCSR()
    return np.repeat(np.arange(len(indptr) - 1), np.diff(indptr)), columns.astype(np.int64), values
