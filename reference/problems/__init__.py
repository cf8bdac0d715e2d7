"""Verification problems: closed forms and published values, each a scene, a quantity and its value."""

from . import bars, homogeneous, meshes, rigid
from .problem import Outcome, Problem, run

ALL: tuple[Problem, ...] = (*rigid.PROBLEMS, *homogeneous.PROBLEMS, *bars.PROBLEMS)

__all__ = ["ALL", "Outcome", "Problem", "meshes", "run"]
