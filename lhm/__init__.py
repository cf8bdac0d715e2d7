"""The layered head model: surfaces, wraps, fitting, identities and expressions. Geometry only, no physics."""

from .files.cache import keep_compiled_functions

keep_compiled_functions()

from . import expressions, identities, scans  # noqa: E402
from .build import build_template, load_template  # noqa: E402
from .check import HeadReport, check_head  # noqa: E402
from .errors import FitError, InputError, MeshError, SoftdecaError  # noqa: E402
from .fit import fit_head  # noqa: E402
from .head import LayeredHead  # noqa: E402
from .mesh import Surface, TetMesh  # noqa: E402
from .template import Template  # noqa: E402

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
