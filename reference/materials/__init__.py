"""Hyperelastic laws [kPa], a file each: parameters, energy density for FEniCSx, derivatives by hand for scikit-fem."""

from . import tissues
from .corotated import Corotated
from .guccione import Guccione
from .incompressible import Incompressible
from .isochoric_neo_hookean import IsochoricNeoHookean
from .material import EnergyLaw, Isotropic, Material, lame
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
    Guccione,
    EnergyLaw,
    Incompressible,
)
"""The laws that there are, and EnergyLaw for those that files add; each solver takes those whose form it can use."""

__all__ = [
    "LAWS",
    "Corotated",
    "EnergyLaw",
    "Guccione",
    "Incompressible",
    "IsochoricNeoHookean",
    "Isotropic",
    "Material",
    "MooneyRivlin",
    "NeoHookean",
    "StVenantKirchhoff",
    "StableNeoHookean",
    "Volumetric",
    "lame",
    "tissues",
]
