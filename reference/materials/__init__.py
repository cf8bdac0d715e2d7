"""Hyperelastic laws [kPa], a file each: parameters, and the energy density by invariants."""

from .corotated import Corotated
from .incompressible import Incompressible
from .isochoric_neo_hookean import IsochoricNeoHookean
from .material import EnergyLaw, Isotropic, Material, MixedLaw, lame
from .mooney_rivlin import MooneyRivlin
from .neo_hookean import NeoHookean
from .st_venant_kirchhoff import StVenantKirchhoff
from .stable_neo_hookean import StableNeoHookean
from .volumetric import Volumetric

LAWS: tuple[type[Material], ...] = (
    NeoHookean,
    StableNeoHookean,
    Corotated,
    StVenantKirchhoff,
    IsochoricNeoHookean,
    MooneyRivlin,
    EnergyLaw,
    Incompressible,
)
"""The laws that there are, and EnergyLaw for those that files add; each solver takes those whose form it can use."""

__all__ = [
    "LAWS",
    "Corotated",
    "EnergyLaw",
    "Incompressible",
    "IsochoricNeoHookean",
    "Isotropic",
    "Material",
    "MixedLaw",
    "MooneyRivlin",
    "NeoHookean",
    "StVenantKirchhoff",
    "StableNeoHookean",
    "Volumetric",
    "lame",
]
