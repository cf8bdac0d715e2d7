"""Scenes, the solvers that consume them, and the problems that verify them."""

from ..lhm.errors import MissingDependencyError, SceneError
from . import materials, terms
from .scene import Scene
from .solution import History, Reason, Solution
from .solve import SOLVERS, Prepared, prepare, solve

__all__ = [
    "SOLVERS",
    "History",
    "MissingDependencyError",
    "Prepared",
    "Reason",
    "Scene",
    "SceneError",
    "Solution",
    "materials",
    "prepare",
    "solve",
    "terms",
]
