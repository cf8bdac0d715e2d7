"""Energy densities of hyperelastic laws in UFL, which derives stress and tangent.

Each takes the deformation gradient and the law's parameters as symbols named like the material's fields.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ufl

from ..materials import (
    Guccione,
    IsochoricNeoHookean,
    Material,
    MooneyRivlin,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    Volumetric,
)

Density = Callable[[Any, Any], Any]


def neo_hookean(F, p, share=1):
    """mu/2 (I1 - 3) - mu ln J + share lmbda/2 ln²J; not a number where J <= 0."""
    log_J = ufl.ln(ufl.det(F))
    return p.mu / 2 * (ufl.inner(F, F) - 3) - p.mu * log_J + share * p.lmbda / 2 * log_J**2


def stable_neo_hookean(F, p):
    """The law less its value at rest, where I1 = 3 and J = 1; finite for every F."""
    mu, lmbda = 4 * p.mu / 3, p.lmbda + 5 * p.mu / 6
    I1, away = ufl.inner(F, F), ufl.det(F) - 1
    # lmbda/2 (J - a)² less its value at rest, with lmbda (a - 1) = 3/4 mu
    volume = lmbda / 2 * away**2 - 3 * mu / 4 * away
    return mu / 2 * (I1 - 3) + volume - mu / 2 * ufl.ln((I1 + 1) / 4)


def st_venant_kirchhoff(F, p):
    """Linear elasticity's energy mu tr E² + lmbda/2 tr²E; finite for every F."""
    E = (F.T * F - ufl.Identity(3)) / 2
    return p.mu * ufl.inner(E, E) + p.lmbda / 2 * ufl.tr(E) ** 2


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
