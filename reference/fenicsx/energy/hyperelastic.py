"""Laws with a pressure by UFL: an argument of the density like F, and what it adds are derivatives."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import ufl

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


class MixedForms:
    """Compiled derivatives of a law with a pressure on some cells (k,), by the rule of a degree.

    `gradient` is the energy's by a displacement function [mm], `by_pressure` that by the pressure's [kPa] (mm³),
    `coupling` that by both [mm²], and `by_pressure_twice` that by the pressure twice, negative semi-definite [mm³/kPa].
    A law's vectors and growth go by the cells.
    """

    def __init__(self, displacement, cells: Ints, material: Material, degree: int, growth: Floats | float, pressure):
        self.cells = cells
        space = displacement.function_space
        psi, _ = density(displacement, cells, material, growth, pressure)
        energy = psi * seam.cell_measure(space.mesh, cells)(metadata={"quadrature_degree": degree})
        gradient = ufl.derivative(energy, displacement, ufl.TestFunction(space))
        trial, test = (make(pressure.function_space) for make in (ufl.TrialFunction, ufl.TestFunction))
        by_pressure = ufl.derivative(energy, pressure, test)
        self.gradient = seam.compile_form(gradient)
        self.by_pressure = seam.compile_form(by_pressure)
        self.coupling = seam.compile_form(ufl.derivative(gradient, pressure, trial))
        self.by_pressure_twice = seam.compile_form(ufl.derivative(by_pressure, pressure, trial))
