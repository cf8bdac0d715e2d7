"""What this solver models, and by how many processes."""

from __future__ import annotations

from ..materials import Corotated, Material
from ..scene import Scene
from ..terms import (
    Bending,
    Fixed,
    Gravity,
    Hyperelastic,
    Inertia,
    Pressure,
    RigidBody,
    Strain,
    SurfaceStrain,
    Target,
    Traction,
    Volume,
)
from .densities import BY_DENSITY
from .dolfinx_version import ALL, ALONE, MPI

TERMS = (
    Hyperelastic,
    Strain,
    Volume,
    SurfaceStrain,
    Bending,
    Target,
    Fixed,
    RigidBody,
    Gravity,
    Traction,
    Pressure,
    Inertia,
)
LAWS: tuple[type[Material], ...] = (*BY_DENSITY, Corotated)
DEGREE_OF = {"P1": 1, "P2": 2, "P2P1": 2}
"""The degree of each element's displacement."""
MOVING_TERMS = tuple(kind for kind in TERMS if kind not in (RigidBody, Pressure, Inertia))
"""Those of a march: mass is given to it."""
FEW = 300
"""Tets per process, below which dividing them costs more than it saves."""


def processes_for(scene: Scene) -> MPI.Intracomm:
    """Those that divide a scene: all that mpirun has started; of a small one each has the whole."""
    return ALL if len(scene.tets) >= FEW * ALL.size else ALONE
