"""The layered head model: surfaces, wraps, fitting, identities and expressions. Geometry only, no physics."""

from .errors import FitError, InputError, MeshError, SoftdecaError
from .head import LayeredHead
from .mesh import Surface, TetMesh

__all__ = ["FitError", "InputError", "LayeredHead", "MeshError", "SoftdecaError", "Surface", "TetMesh"]
