"""The layered head model: surfaces, wraps, fitting, identities and expressions. Geometry only, no physics."""

from .errors import FitError, InputError, MeshError, SoftdecaError
from .mesh import Surface, TetMesh

__all__ = ["FitError", "InputError", "MeshError", "SoftdecaError", "Surface", "TetMesh"]
