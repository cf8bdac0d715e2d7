"""Hyperelastic laws by UFL: the law is its energy density; stress and tangent are its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl

from ...lhm.mesh import Floats, Ints
from ..materials import NeoHookean
from . import dolfinx_version as seam


def neo_hookean(F, mu, lmbda):
    """mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J (Bonet and Wood 2008, Eq. 6.27); not a number where J <= 0."""
    log_J = ufl.ln(ufl.det(F))
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * log_J + lmbda / 2 * log_J**2


@dataclass(frozen=True, eq=False)
class HyperelasticForms:
    """Compiled energy, gradient and tangent of a law on some cells; mu and lmbda are read when assembled."""

    cells: Ints
    mu: Any
    lmbda: Any
    energy: Any
    gradient: Any
    tangent: Any

    @classmethod
    def of(cls, displacement, cells: Ints) -> HyperelasticForms:
        """Forms for the displacement function [mm] on cells (k,)."""
        space = displacement.function_space
        mu, lmbda = (seam.constant(space.mesh, value) for value in (1.0, 1.0))
        F = ufl.Identity(3) + ufl.grad(displacement)
        energy = neo_hookean(F, mu, lmbda) * seam.cell_measure(space.mesh, cells)
        gradient = ufl.derivative(energy, displacement, ufl.TestFunction(space))
        tangent = ufl.derivative(gradient, displacement, ufl.TrialFunction(space))
        return cls(cells, mu, lmbda, *(seam.compile_form(form) for form in (energy, gradient, tangent)))

    def set(self, material: NeoHookean):
        """Take a material's parameters [kPa]."""
        self.mu.value = material.mu
        self.lmbda.value = material.lmbda

    def assemble_energy(self) -> float:
        """Energy [µJ]; infinite where J <= 0 in any cell."""
        value = seam.assemble_scalar(self.energy)
        return value if np.isfinite(value) else np.inf

    def add_gradient(self, into: Floats):
        """Add the gradient [mN] to an array of dofs (3n,)."""
        seam.add_vector(self.gradient, into)
