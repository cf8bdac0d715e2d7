"""The layered head model: surfaces, wraps, fitting, identities and expressions. Geometry only, no physics."""

from . import expressions, identities, scans
from .build import build_template
from .check import HeadReport, check_head
from .errors import FitError, InputError, MeshError, SoftdecaError
from .fit import fit_head
from .head import LayeredHead
from .mesh import Surface, TetMesh
from .template import Template, load_template

__all__ = [
    "FitError",
    "HeadReport",
    "InputError",
    "LayeredHead",
    "MeshError",
    "SoftdecaError",
    "Surface",
    "Template",
    "TetMesh",
    "build_template",
    "check_head",
    "expressions",
    "fit_head",
    "identities",
    "load_template",
    "scans",
]
