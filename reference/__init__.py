"""Scenes, the solvers that consume them, and the problems that verify them."""

from ..lhm.base.errors import MissingDependencyError, SceneError
from . import materials, terms
from .added import SOLVERS, NotModelledError, add_file, add_law, add_solver
from .face.face import Face
from .face.facial import apply_law, facial_scene
from .face.free_scenes import open_jaw_scene, push_cheek_scene
from .face.parameters import ParameterInfo, Parameters
from .face.sequence import Sequence
from .face.settle import SettledFace, settle
from .face.tissue import nested_start
from .march import Moment, march
from .scene import Scene
from .solution import History, Reason, Solution, Times, write_solution
from .solve import Prepared, prepare, solve

__all__ = [
    "SOLVERS",
    "Face",
    "History",
    "MissingDependencyError",
    "Moment",
    "NotModelledError",
    "ParameterInfo",
    "Parameters",
    "Prepared",
    "Reason",
    "Scene",
    "SceneError",
    "Sequence",
    "SettledFace",
    "Solution",
    "Times",
    "add_file",
    "add_law",
    "add_solver",
    "apply_law",
    "facial_scene",
    "march",
    "materials",
    "nested_start",
    "open_jaw_scene",
    "prepare",
    "push_cheek_scene",
    "settle",
    "solve",
    "terms",
    "write_solution",
]
