"""The terms a scene is made of: energies, constraints and loads. A term names what it acts on.

Energies are integrals over the rest configuration. Units: mm, kPa (= mN/mm²), kg/mm³; energies µJ = mN·mm.
A term without `tets` acts on all tets. Stiffnesses and the like are one number, or one per element acted on. Energies
of tissue take `tets` in rows of three as well, shape (k, 3): the tets of a prism, which share one deformation.
"""

from .cells import Cells
from .contact import Contact, Gaps, Obstacle
from .loads import Gravity, Pressure, Traction
from .solids import Hourglass, Hyperelastic, Solid, Strain, Volume
from .surfaces import Bending, SurfaceStrain
from .term import Amount, Mesh, OnTets, OnTriangles, Term
from .vertices import Fixed, RigidBody, Target

__all__ = [
    "Amount",
    "Bending",
    "Cells",
    "Contact",
    "Fixed",
    "Gaps",
    "Gravity",
    "Hourglass",
    "Hyperelastic",
    "Mesh",
    "Obstacle",
    "OnTets",
    "OnTriangles",
    "Pressure",
    "RigidBody",
    "Solid",
    "Strain",
    "SurfaceStrain",
    "Target",
    "Term",
    "Traction",
    "Volume",
]
