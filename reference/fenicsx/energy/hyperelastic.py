"""UFL forms of laws with a pressure: the derivatives of their density by displacement and pressure."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import ufl

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ... import materials
from ...materials import EnergyLaw, Incompressible, Material, MixedLaw
from .. import dolfinx_version as seam

FUNCTIONS = SimpleNamespace(
    log=ufl.ln,
    exp=ufl.exp,
    sqrt=ufl.sqrt,
    sin=ufl.sin,
    cos=ufl.cos,
    tanh=ufl.tanh,
    arctan=ufl.atan,
    where=ufl.conditional,
)
"""The functions that a law's formula may call."""


def symbols(material: Material, domain) -> SimpleNamespace:
    """A law's parameters as UFL's: numbers become constants, so that forms are compiled once per law."""
    values = {field.name: getattr(material, field.name) for field in fields(material)}
    for name, value in values.items():
        if isinstance(value, (int, float, np.number)):
            values[name] = seam.constant(domain, float(value))
    return SimpleNamespace(**values)


def density(displacement, cells: Ints, material: Material, growth: Floats | float, pressure):
    """A law's growth psi(F growth^(-1/3)), and the F that it can be derived by, as UFL's expressions.

    psi is the law's mixed density. Without growth F stays itself, so that forms stay small.
    """
    F = ufl.variable(ufl.Identity(3) + ufl.grad(displacement))
    domain = displacement.function_space.mesh
    ratio = 1 if np.all(growth == 1.0) else seam.cell_numbers(domain, cells, growth)
    elastic = F if ratio == 1 else F * ratio ** (-1 / 3)
    C = elastic.T * elastic
    I1, J = ufl.tr(C), ufl.det(elastic)
    I2 = (I1**2 - ufl.inner(C, C)) / 2
    law = material.law if isinstance(material, Incompressible) else material
    assert isinstance(law, EnergyLaw)
    p = symbols(law, domain)
    assert isinstance(material, (MixedLaw, Incompressible))
    return ratio * material.mixed_density(I1, I2, J, pressure, p, FUNCTIONS), F


def check_mixed(material: Material):
    """Raise SceneError for a law that mixed elements cannot model: without a mixed density, or where it fails."""
    if isinstance(material, Incompressible):
        return
    if not isinstance(material, MixedLaw):
        names = ", ".join(kind.__name__ for kind in materials.LAWS if issubclass(kind, MixedLaw))
        raise SceneError(f"element 'P2P1' cannot model {material.name} by a pressure; it models {names}")
    try:
        material.check_mixed()
    except SceneError as error:
        raise SceneError(f"element 'P2P1': {error}") from None


class MixedForms:
    """Compiled derivatives of a law with a pressure on some cells (k,), by the rule of a degree.

    `by_pressure` is the energy's by the pressure's function [kPa] (mm³), `coupling` that by pressure and displacement
    [mm²], and `by_pressure_twice` that by the pressure twice, negative semi-definite [mm³/kPa].
    Growth goes by the cells.
    """

    def __init__(self, displacement, cells: Ints, material: Material, degree: int, growth: Floats | float, pressure):
        self.cells = cells
        space = displacement.function_space
        psi, _ = density(displacement, cells, material, growth, pressure)
        energy = psi * seam.cell_measure(space.mesh, cells)(metadata={"quadrature_degree": degree})
        gradient = ufl.derivative(energy, displacement, ufl.TestFunction(space))
        trial, test = (make(pressure.function_space) for make in (ufl.TrialFunction, ufl.TestFunction))
        by_pressure = ufl.derivative(energy, pressure, test)
        self.by_pressure = seam.compile_form(by_pressure)
        self.coupling = seam.compile_form(ufl.derivative(gradient, pressure, trial))
        self.by_pressure_twice = seam.compile_form(ufl.derivative(by_pressure, pressure, trial))
