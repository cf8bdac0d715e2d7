"""Hyperelastic laws as parameters [kPa]; each solver writes the energy itself, so that one can check the other."""

from . import tissues
from .corotated import Corotated
from .energy_law import EnergyLaw
from .guccione import Guccione
from .incompressible import Incompressible
from .isochoric_neo_hookean import IsochoricNeoHookean, Volumetric
from .material import Isotropic, Material, lame
from .mooney_rivlin import MooneyRivlin
from .neo_hookean import NeoHookean
from .st_venant_kirchhoff import StVenantKirchhoff
from .stable_neo_hookean import StableNeoHookean

__all__ = [
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
