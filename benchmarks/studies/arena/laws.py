"""The laws of the arena's solvers, each as terms that FEniCSx models."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ....lhm.base.mesh import Ints
from ....reference import materials, terms
from ....reference.added import added_laws
from ....reference.materials import EnergyLaw, Material
from ....reference.materials.material import LameLaw


@dataclass(frozen=True)
class PlainStable(LameLaw, EnergyLaw):
    """psi = mu/2 (I1 - 3) + (lmbda + mu)/2 ((J - a)² - (1 - a)²), a = 1 + mu/(lmbda + mu); mu and lmbda [kPa].

    Smith, de Goes and Kim 2018, "Stable neo-Hookean flesh simulation", Eq. 13: without the logarithm of Eq. 14.
    """

    finite_inverted = True

    def density(self, I1: Any, I2: Any, J: Any, p: Any, m: Any) -> Any:
        bulk = p.lmbda + p.mu
        shift = p.mu / bulk
        return p.mu / 2 * (I1 - 3) + bulk / 2 * ((J - 1 - shift) ** 2 - shift**2)


Solid = Callable[[float, float, Ints], list[terms.Term]]
"""The terms of tets (k,) with Lamé's mu and lmbda [kPa] at rest."""


def _hyperelastic(law: Callable[[float, float], Material]) -> Solid:
    return lambda mu, lmbda, tets: [terms.Hyperelastic(law(mu, lmbda), tets=tets)]


def _isochoric(mu: float, lmbda: float) -> materials.IsochoricNeoHookean:
    return materials.IsochoricNeoHookean(mu, lmbda + 2.0 / 3.0 * mu)


def _projective(mu: float, lmbda: float, tets: Ints) -> list[terms.Term]:
    return [terms.Strain(2.0 * mu, tets=tets), terms.Volume(3.0 * lmbda, tets=tets)]


def _rigid(mu: float, lmbda: float, tets: Ints) -> list[terms.Term]:
    return [terms.Strain(2.0 * mu, tets=tets)]


NEO_HOOKEAN, PROJECTIVE, ST_VENANT, RIGID = (
    "neo-Hookean",
    "projective dynamics",
    "St. Venant-Kirchhoff",
    "as rigid as possible",
)
ISOCHORIC, PLAIN_STABLE = "isochoric neo-Hookean", "stable neo-Hookean without logarithm"
LAWS: Mapping[str, Solid] = {
    NEO_HOOKEAN: _hyperelastic(materials.NeoHookean),
    ST_VENANT: _hyperelastic(materials.StVenantKirchhoff),
    ISOCHORIC: _hyperelastic(_isochoric),
    "stable neo-Hookean": _hyperelastic(materials.StableNeoHookean),
    PLAIN_STABLE: _hyperelastic(PlainStable),
    PROJECTIVE: _projective,
    RIGID: _rigid,
}
"""Laws by the name in a solver's file; libigl's answer is independent of mu, projective dynamics' of a factor."""


def find_law(name: str) -> Solid:
    """Give a law of LAWS, or one that a file has added."""
    return LAWS[name] if name in LAWS else _hyperelastic(added_laws()[name].of_moduli)
