"""The layered head model: surfaces, wraps, fitting, identities and expressions. Geometry only, no physics."""

from . import expressions, identities, scans
from .base.errors import FitError, InputError, MeshError, SoftdecaError
from .base.mesh import Surface, TetMesh
from .head.gates import HeadReport, check_head
from .head.head import LayeredHead
from .template.build import build_template, load_template
from .template.fit import fit_head
from .template.template import Template

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
