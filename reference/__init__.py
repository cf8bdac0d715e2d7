"""Scenes, the solvers that consume them, and the problems that verify them."""

from ..lhm.base.errors import MissingDependencyError, SceneError
from . import materials, ranks, terms
from .added import SOLVERS, NotModelledError, add_file, add_law, add_solver
from .face.facial import facial_scene, hyperelastic_scene, neo_hookean_scene
from .face.free_scenes import open_jaw_scene, push_cheek_scene
from .face.minimal import FacialModel, Smallest, smallest_facial_scene, smallest_scene
from .face.nested import nested_start
from .face.parameters import ParameterInfo, Parameters
from .face.sequence import Sequence
from .face.settling import Settled, settled
from .march import march
from .scene import Scene
from .solution import History, Reason, Solution, Times
from .solution_file import write_solution
from .solve import Prepared, prepare, solve
from .trajectory import Trajectory

__all__ = [
    "SOLVERS",
    "FacialModel",
    "History",
    "MissingDependencyError",
    "NotModelledError",
    "ParameterInfo",
    "Parameters",
    "Prepared",
    "Reason",
    "Scene",
    "SceneError",
    "Sequence",
    "Settled",
    "Smallest",
    "Solution",
    "Times",
    "Trajectory",
    "add_file",
    "add_law",
    "add_solver",
    "facial_scene",
    "hyperelastic_scene",
    "march",
    "materials",
    "neo_hookean_scene",
    "nested_start",
    "open_jaw_scene",
    "prepare",
    "push_cheek_scene",
    "ranks",
    "settled",
    "smallest_facial_scene",
    "smallest_scene",
    "solve",
    "terms",
    "write_solution",
]
