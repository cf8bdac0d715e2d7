"""What this solver models, and by how many processes."""

from __future__ import annotations

from ...lhm.base.errors import SceneError
from .. import materials
from ..materials.material import HasDensity, HasStretches
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
from .dolfinx_version import ALL, ALONE, MPI
from .parts import PartScene

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
LAWS = tuple(law for law in materials.LAWS if issubclass(law, (HasDensity, HasStretches)))
DEGREE_OF = {"P1": 1, "P2": 2, "P2P1": 2}
"""The degree of each element's displacement."""
MOVING_TERMS = tuple(kind for kind in TERMS if kind not in (RigidBody, Pressure, Inertia))
"""Those of a march: mass is given to it."""
FEW = 300
"""Tets per process, below which dividing them costs more than it saves."""


def refuse_in_parts(scene: Scene):
    """Raise SceneError for what a scene in parts cannot have: what joins vertices of more than one process."""
    for term in scene.terms if scene.in_parts else ():
        if isinstance(term, (Bending, RigidBody, Inertia)):
            raise SceneError(f"solver 'fenicsx' cannot model {term.name} of a scene that processes have in parts")


def processes_for(scene: Scene) -> MPI.Intracomm:
    """Those that divide a scene: all that mpirun has started, or that have it in parts; of a small one each has all."""
    if isinstance(scene, PartScene):
        return scene.part.comm
    return ALL if len(scene.tets) >= FEW * ALL.size else ALONE
