"""Verification problems: closed forms and published values, each a scene, a quantity and its value."""

from . import bars, homogeneous, meshes, rigid, stretched_laws
from .problem import Outcome, Problem, run

ALL: tuple[Problem, ...] = (*rigid.PROBLEMS, *homogeneous.PROBLEMS, *stretched_laws.PROBLEMS, *bars.PROBLEMS)

__all__ = ["ALL", "Outcome", "Problem", "meshes", "run"]
