"""Hyperelastic laws by UFL: the law is its energy density; stress and tangent are its derivatives.

An independent pressure is an argument of the density like F, and what it adds are derivatives too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ... import materials
from ...materials import Incompressible, Material
from ...materials.material import HasDensity, HasMixedDensity
from .. import dolfinx_version as seam


def symbols(material: Material, domain, cells: Ints) -> SimpleNamespace:
    """A law's parameters as UFL's: constants, so that forms are compiled once per law, and vectors per cell.

    Vectors of shape (3,) or, in the order of cells (k,), (k, 3).
    """
    values: dict[str, Any] = {}
    for field in fields(material):
        value = getattr(material, field.name)
        if isinstance(value, np.ndarray):
            values[field.name] = seam.cell_vectors(domain, cells, value)
        elif isinstance(value, (int, float, np.number)):
            values[field.name] = seam.constant(domain, float(value))
        else:
            values[field.name] = value
    return SimpleNamespace(**values)


def density(displacement, cells: Ints, material: Material, growth: Floats | float = 1.0, pressure=None):
    """A law's growth psi(F growth^(-1/3)), and the F that it can be derived by, as UFL's expressions.

    With a pressure psi is the law's mixed density.
    """
    F = ufl.variable(ufl.Identity(3) + ufl.grad(displacement))
    domain = displacement.function_space.mesh
    elastic, ratio = elastic_part(F, growth, domain, cells)
    law = material.law if isinstance(material, Incompressible) else material
    parameters = symbols(law, domain, cells)
    if pressure is None:
        assert isinstance(law, HasDensity)
        return ratio * law.density(elastic, parameters), F
    assert isinstance(material, (HasMixedDensity, Incompressible))
    return ratio * material.mixed_density(elastic, pressure, parameters), F


def check_mixed(material: Material):
    """Raise SceneError for a law that mixed elements cannot model: without a mixed density, or where it fails."""
    law = material.law if isinstance(material, Incompressible) else material
    if not isinstance(law, HasMixedDensity):
        names = ", ".join(kind.__name__ for kind in materials.LAWS if issubclass(kind, HasMixedDensity))
        raise SceneError(f"element 'P2P1' cannot model {law.name} by a pressure; it models {names}")
    if law is material:
        try:
            law.check_mixed()
        except SceneError as error:
            raise SceneError(f"element 'P2P1': {error}") from None


def elastic_part(F, growth: Floats | float, domain, cells: Ints):
    """F growth^(-1/3) and growth, of one number or one per cell (k,); without growth F itself: forms stay small."""
    if np.all(growth == 1.0):
        return F, 1
    ratio = seam.cell_numbers(domain, cells, growth)
    return F * ratio ** (-1 / 3), ratio


class HyperelasticForms:
    """Compiled energy, gradient and tangent of a law on some cells (k,), and P and dP/dF there.

    They are of a displacement function [mm], and of a pressure's [kPa] if there is one: then there is also the energy's
    derivative by it [mm³], that by displacement and pressure [mm²], and that by the pressure twice, negative
    semi-definite [mm³/kPa]. A law's vectors and growth go by the cells; all is by the rule of a degree.
    """

    def __init__(
        self,
        displacement,
        cells: Ints,
        material: Material,
        degree: int = 1,
        growth: Floats | float = 1.0,
        pressure=None,
    ):
        space = displacement.function_space
        self.cells, self._degree, self._domain = cells, degree, space.mesh
        self._psi, self._F = density(displacement, cells, material, growth, pressure)
        measure = seam.cell_measure(space.mesh, cells)(metadata={"quadrature_degree": degree})
        self._energy, self._space = self._psi * measure, space
        self._gradient = ufl.derivative(self._energy, displacement, ufl.TestFunction(space))
        self._displacement = displacement
        if pressure is not None:
            trial, test = (make(pressure.function_space) for make in (ufl.TrialFunction, ufl.TestFunction))
            by_pressure = ufl.derivative(self._energy, pressure, test)
            self.by_pressure = seam.compile_form(by_pressure)
            self.coupling = seam.compile_form(ufl.derivative(self._gradient, pressure, trial))
            self.by_pressure_twice = seam.compile_form(ufl.derivative(by_pressure, pressure, trial))

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
        return seam.evaluator(expand_derivatives(expression), seam.quadrature_rule(self._degree)[0], self._domain)

    def assemble_energy(self) -> float:
        """Energy [µJ] of this process' cells; infinite where the law does not hold in any of them."""
        value = seam.assemble_scalar(self.energy)
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
