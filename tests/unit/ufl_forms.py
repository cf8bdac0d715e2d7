"""UFL's forms of a law with a pressure, assembled by DOLFINx: kernels are held against them."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives

from softdeca.lhm.base.mesh import Floats, Ints
from softdeca.reference.fenicsx import dolfinx_version as seam
from softdeca.reference.fenicsx.energy.hyperelastic import density
from softdeca.reference.materials import Material


def assemble_tangent(order, quadrature, cells, C):
    """The integral of grad v : dP/dF : grad u [mN/mm], dense, of dP/dF [kPa] (m q, 9, 9) at points of cells (m,)."""
    nodes, q = order.cell_dofs[cells], quadrature.per_cell
    m, k = nodes.shape
    gradients = np.einsum("qad,edj->eqaj", quadrature._derivatives, quadrature._inverse[cells])
    volume = quadrature.volume.reshape(-1, q)[cells]
    weighted = volume[:, :, None, None, None, None] * C.reshape(m, q, 3, 3, 3, 3)
    local = np.einsum("eqas,eqisjt,eqbt->eaibj", gradients, weighted, gradients, optimize=True)
    dofs = (3 * nodes[:, :, None] + np.arange(3)).reshape(m, 3 * k)
    dense = np.zeros((order.X.size, order.X.size))
    np.add.at(dense, (dofs[:, :, None], dofs[:, None, :]), local.reshape(m, 3 * k, 3 * k))
    return dense


class HyperelasticForms:
    """Compiled energy, gradient and tangent of a law on some cells (k,), and P and dP/dF there.

    They are of a displacement function [mm], and of a pressure's [kPa].
    """

    def __init__(
        self,
        displacement,
        cells: Ints,
        material: Material,
        degree: int,
        growth: Floats | float,
        pressure,
    ):
        space = displacement.function_space
        self.cells, self._degree, self._domain = cells, degree, space.mesh
        self._psi, self._F = density(displacement, cells, material, growth, pressure)
        measure = seam.cell_measure(space.mesh, cells)(metadata={"quadrature_degree": degree})
        self._energy, self._space = self._psi * measure, space
        self._gradient = ufl.derivative(self._energy, displacement, ufl.TestFunction(space))
        self._displacement = displacement

    # The code of these may be large, and is not always needed.
    @cached_property
    def energy(self):
        """The energy's form."""
        return seam.compile_form(self._energy)

    @cached_property
    def gradient(self):
        """The form of the gradient by the displacement."""
        return seam.compile_form(self._gradient)

    @cached_property
    def tangent(self):
        """The form of the second derivative by the displacement."""
        return seam.compile_form(ufl.derivative(self._gradient, self._displacement, ufl.TrialFunction(self._space)))

    @cached_property
    def _stress(self) -> Callable[[Ints], Floats]:
        return self._evaluator(ufl.diff(self._psi, self._F))

    @cached_property
    def _stress_derivative(self) -> Callable[[Ints], Floats]:
        return self._evaluator(ufl.diff(ufl.diff(self._psi, self._F), self._F))

    def _evaluator(self, expression) -> Callable[[Ints], Floats]:
        """Compile an expression's evaluator at the rule's points.

        Derivatives are taken first: dolfinx would count the constants of what they drop, and take others for them.
        """
        points, shape = seam.quadrature_rule(self._degree)[0], expression.ufl_shape
        with seam._serialise_compilation(seam.communicator(self._domain)):
            compiled = seam.fem.Expression(expand_derivatives(expression), points, **seam._COMPILER)
        first = () if seam.VERSION < (0, 7) else (self._domain,)
        return lambda cells: compiled.eval(*first, cells.astype(np.int32)).reshape(
            len(cells), len(points), int(np.prod(shape))
        )

    def assemble_energy(self) -> float:
        """Energy [µJ] of this process' cells; infinite where the law does not hold in any of them."""
        value = float(seam.fem.assemble_scalar(self.energy))
        return value if np.isfinite(value) else np.inf

    def add_gradient(self, into: Floats):
        """Add the gradient [mN] of this process' cells to a field of dofs (3n,)."""
        seam.add_vector(self.gradient, into)

    def point_stress(self) -> Floats:
        """P [kPa] at the points, shape (k q, 3, 3)."""
        return self._stress(self.cells).reshape(-1, 3, 3)

    def point_tangent(self) -> Floats:
        """dP/dF [kPa] at the points, shape (k q, 9, 9)."""
        return self._stress_derivative(self.cells).reshape(-1, 9, 9)

    def softened_tangent(self, kept: float) -> Floats:
        """dP/dF [kPa] at the points, shape (k q, 9, 9), every negative eigenvalue multiplied by `kept`."""
        values, vectors = np.linalg.eigh(self.point_tangent())
        return (vectors * np.maximum(values, kept * values)[:, None, :]) @ vectors.transpose(0, 2, 1)
