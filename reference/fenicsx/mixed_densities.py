"""Densities of laws with an independent pressure p, in UFL: stationary in p they give the law back.

A volumetric part U(J) is replaced by p (J - 1) - U*(p) with U* its Legendre transform, or kappa/2 g² by
p g - p²/(2 kappa); both stay finite as the bulk modulus grows, and without U* they enforce J = 1 (Sussman and Bathe
1987, "A finite element formulation for nonlinear incompressible elastic and inelastic analysis").
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ufl

from ...lhm.errors import SceneError
from ..materials import (
    Guccione,
    Incompressible,
    IsochoricNeoHookean,
    Isotropic,
    Material,
    MooneyRivlin,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    Volumetric,
)
from . import densities
from .densities import ISOCHORIC, Density, isochoric_neo_hookean

MixedDensity = Callable[[Any, Any, Any], Any]
"""The density from F, the pressure p and the law's parameters."""


def neo_hookean(F, p, law):
    """lmbda/2 ln²J by p = lmbda ln J, but for a share of it.

    That share, mu/lmbda or a half, stays at the points: alone a tension p > mu would beat -mu ln J as J falls to 0, and
    crush single points.
    """
    share = ufl.conditional(ufl.lt(2 * law.mu, law.lmbda), law.mu / law.lmbda, 0.5)
    at_points = densities.neo_hookean(F, law, share)
    return at_points + (1 - share) * (p * ufl.ln(ufl.det(F)) - p**2 / (2 * law.lmbda))


def stable(F, p, law):
    """The quadratic part in J by the pressure."""
    mu, lmbda = 4 * law.mu / 3, law.lmbda + 5 * law.mu / 6
    I1, away = ufl.inner(F, F), ufl.det(F) - 1
    elastic = mu / 2 * (I1 - 3) - mu / 2 * ufl.ln((I1 + 1) / 4) - 3 * mu / 4 * away
    return elastic + p * away - p**2 / (2 * lmbda)


def kirchhoff(F, p, law):
    """lmbda/2 tr²E by the pressure."""
    E = (F.T * F - ufl.Identity(3)) / 2
    return law.mu * ufl.inner(E, E) + p * ufl.tr(E) - p**2 / (2 * law.lmbda)


def complementary(p, law):
    """U*(p) of the volumetric part; of the logarithmic one U'(J) = kappa/2 (J - 1/J) = p gives J."""
    if getattr(law, "volumetric", Volumetric.QUADRATIC) is Volumetric.LOGARITHMIC:
        q = p / law.kappa
        J = q + ufl.sqrt(1 + q**2)
        return p * (J - 1) - law.kappa / 4 * (J**2 - 1 - 2 * ufl.ln(J))
    return p**2 / (2 * law.kappa)


def _with_pressure(isochoric) -> MixedDensity:
    return lambda F, p, law: isochoric(F, law) + p * (ufl.det(F) - 1) - complementary(p, law)


def isochoric_stable(F, law):
    """The stable law where J = 1, of J^(-2/3) I1."""
    I1 = ufl.det(F) ** (-2 / 3) * ufl.inner(F, F)
    return 2 * law.mu / 3 * (I1 - 3 - ufl.ln((I1 + 1) / 4))


def isochoric_kirchhoff(F, law):
    """The St. Venant-Kirchhoff law of J^(-2/3) FᵀF."""
    E = (ufl.det(F) ** (-2 / 3) * F.T * F - ufl.Identity(3)) / 2
    return law.mu * ufl.inner(E, E) + law.lmbda / 2 * ufl.tr(E) ** 2


# The part of a law that Incompressible keeps.
SHAPE: dict[type[Material], Density] = {
    **ISOCHORIC,
    NeoHookean: isochoric_neo_hookean,
    StableNeoHookean: isochoric_stable,
    StVenantKirchhoff: isochoric_kirchhoff,
}
MIXED: dict[type[Material], MixedDensity] = {
    NeoHookean: neo_hookean,
    StableNeoHookean: stable,
    StVenantKirchhoff: kirchhoff,
    **{law: _with_pressure(ISOCHORIC[law]) for law in (IsochoricNeoHookean, MooneyRivlin, Guccione)},
}


def shear_modulus(material: Material) -> float:
    """The scale [kPa] of a law's resistance to a change of shape."""
    law = material.law if isinstance(material, Incompressible) else material
    return law.lame[0] if isinstance(law, Isotropic) else law.stiffness


def check_mixed(material: Material):
    """Raise SceneError for a law without a form by pressure, or whose bulk part is not positive."""
    law = material.law if isinstance(material, Incompressible) else material
    if type(law) not in MIXED:
        names = ", ".join(kind.__name__ for kind in MIXED)
        raise SceneError(f"element 'P2P1' cannot model {law.name} by a pressure; it models {names}")
    if law is material and isinstance(law, (NeoHookean, StVenantKirchhoff)) and law.lmbda <= 0:
        raise SceneError(f"element 'P2P1': {law.name} needs lmbda above 0, got {law.lmbda}")


def mixed_density(F, p, material: Material, parameters):
    """The density of a law that passed `check_mixed`; `parameters` are its own, or of the law made incompressible."""
    if isinstance(material, Incompressible):
        return SHAPE[type(material.law)](F, parameters) + p * (ufl.det(F) - 1)
    return MIXED[type(material)](F, p, parameters)
