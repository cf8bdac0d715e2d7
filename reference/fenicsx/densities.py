"""Energy densities of hyperelastic laws in UFL, which derives stress and tangent.

Each takes the deformation gradient and the law's parameters as symbols named like the material's fields.

Mixed ones take an independent pressure p too: stationary in p they give the law back. A volumetric part U(J) is
replaced by p (J - 1) - U*(p) with U* its Legendre transform, or kappa/2 g² by p g - p²/(2 kappa); both stay finite as
the bulk modulus grows, and without U* they enforce J = 1 (Sussman and Bathe 1987, "A finite element formulation for
nonlinear incompressible elastic and inelastic analysis").
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ufl

from ...lhm.base.errors import SceneError
from ..materials import (
    EnergyLaw,
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

Density = Callable[[Any, Any], Any]


def squared(modulus, g):
    """The bulk part modulus/2 g² of a law."""
    return modulus / 2 * g**2


def neo_hookean(F, p, bulk=squared):
    """mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J; not a number where J <= 0."""
    log_J = ufl.ln(ufl.det(F))
    return p.mu / 2 * (ufl.inner(F, F) - 3) - p.mu * log_J + bulk(p.lmbda, log_J)


def stable_neo_hookean(F, p, bulk=squared):
    """The law less its value at rest, where I1 = 3 and J = 1; finite for every F."""
    mu, lmbda = 4 * p.mu / 3, p.lmbda + 5 * p.mu / 6
    I1, away = ufl.inner(F, F), ufl.det(F) - 1
    # lmbda/2 (J - a)² less its value at rest, with lmbda (a - 1) = 3/4 mu
    volume = bulk(lmbda, away) - 3 * mu / 4 * away
    return mu / 2 * (I1 - 3) + volume - mu / 2 * ufl.ln((I1 + 1) / 4)


def st_venant_kirchhoff(F, p, bulk=squared):
    """Linear elasticity's energy mu tr E² + lmbda/2 tr²E; finite for every F."""
    E = (F.T * F - ufl.Identity(3)) / 2
    return p.mu * ufl.inner(E, E) + bulk(p.lmbda, ufl.tr(E))


def volumetric(F, p):
    """The volumetric part: kappa/2 (J - 1)², if the law does not name another."""
    J = ufl.det(F)
    if getattr(p, "volumetric", Volumetric.QUADRATIC) is Volumetric.LOGARITHMIC:
        return p.kappa / 4 * (J**2 - 1 - 2 * ufl.ln(J))
    return p.kappa / 2 * (J - 1) ** 2


def isochoric_neo_hookean(F, p):
    """The isochoric part, mu/2 (J^(-2/3) I1 - 3); not a number where J <= 0."""
    return p.mu / 2 * (ufl.det(F) ** (-2 / 3) * ufl.inner(F, F) - 3)


def mooney_rivlin(F, p):
    """The isochoric part, C10 (i1 - 3) + C01 (i2 - 3) + C20 (i1 - 3)²; not a number where J <= 0."""
    J, C = ufl.det(F), F.T * F
    i1 = J ** (-2 / 3) * ufl.tr(C)
    i2 = J ** (-4 / 3) * (ufl.tr(C) ** 2 - ufl.inner(C, C)) / 2
    return p.C10 * (i1 - 3) + p.C01 * (i2 - 3) + p.C20 * (i1 - 3) ** 2


def guccione(F, p):
    """The isochoric part, C/2 (exp Q - 1); not a number where J <= 0.

    Q needs no directions across the fibres: |E f|² = E_ff² + E_fs² + E_fn², and tr E² is the sum of all nine squares.
    """
    C, drawn = F.T * F, F * p.fibres
    scale = ufl.det(F) ** (-2 / 3)
    i4, i5 = scale * ufl.inner(drawn, drawn), scale**2 * ufl.inner(F.T * drawn, F.T * drawn)
    squares = (scale**2 * ufl.inner(C, C) - 2 * scale * ufl.tr(C) + 3) / 4
    along, row = (i4 - 1) ** 2 / 4, (i5 - 2 * i4 + 1) / 4
    Q = p.bf * along + p.bt * (squares - 2 * row + along) + 2 * p.bfs * (row - along)
    return p.C / 2 * (ufl.exp(Q) - 1)


def _with_volume(isochoric: Density) -> Density:
    return lambda F, p: isochoric(F, p) + volumetric(F, p)


ISOCHORIC: dict[type[Material], Density] = {
    IsochoricNeoHookean: isochoric_neo_hookean,
    MooneyRivlin: mooney_rivlin,
    Guccione: guccione,
}
DENSITIES: dict[type[Material], Density] = {
    NeoHookean: neo_hookean,
    StableNeoHookean: stable_neo_hookean,
    StVenantKirchhoff: st_venant_kirchhoff,
    **{law: _with_volume(isochoric) for law, isochoric in ISOCHORIC.items()},
}


def density_of(material: Material) -> Density:
    """The density of a law that has one (`BY_DENSITY`)."""
    return material.density if isinstance(material, EnergyLaw) else DENSITIES[type(material)]


BY_DENSITY: tuple[type[Material], ...] = (*DENSITIES, EnergyLaw)  # type: ignore[type-abstract]

MixedDensity = Callable[[Any, Any, Any], Any]
"""The density from F, the pressure p and the law's parameters."""


def _of_pressure(p):
    """The bulk part p g - p²/(2 modulus) in place of modulus/2 g²."""
    return lambda modulus, g: p * g - p**2 / (2 * modulus)


def mixed_neo_hookean(F, p, law):
    """lmbda/2 ln²J by p = lmbda ln J, but for a share of it.

    That share, mu/lmbda or a half, stays at the points: alone a tension p > mu would beat -mu ln J as J falls to 0, and
    crush single points.
    """
    share = ufl.conditional(ufl.lt(2 * law.mu, law.lmbda), law.mu / law.lmbda, 0.5)
    by_pressure = _of_pressure(p)
    return neo_hookean(F, law, lambda modulus, g: share * squared(modulus, g) + (1 - share) * by_pressure(modulus, g))


def complementary(p, law):
    """U*(p) of the volumetric part; of the logarithmic one U'(J) = kappa/2 (J - 1/J) = p gives J."""
    if getattr(law, "volumetric", Volumetric.QUADRATIC) is Volumetric.LOGARITHMIC:
        q = p / law.kappa
        J = q + ufl.sqrt(1 + q**2)
        return p * (J - 1) - law.kappa / 4 * (J**2 - 1 - 2 * ufl.ln(J))
    return p**2 / (2 * law.kappa)


def _with_pressure(isochoric: Density) -> MixedDensity:
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
    NeoHookean: mixed_neo_hookean,
    StableNeoHookean: lambda F, p, law: stable_neo_hookean(F, law, _of_pressure(p)),
    StVenantKirchhoff: lambda F, p, law: st_venant_kirchhoff(F, law, _of_pressure(p)),
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
