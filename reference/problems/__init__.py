"""Verification problems: closed forms and published values, each a scene, a quantity and its value; and hard cases.

Sources are numbered. Problems: V2 homogeneous stretches, V3 time steps, V14 orders of convergence.
Hard cases: H1 random starts, H2 collapse, H3 inversion, H4 flat tets and slivers, H5 large stretches, H6 a twist near
incompressibility, H7 crushed and released, H11 time steps of any length.
"""

from ..added import added_laws
from . import (
    bars,
    cook,
    homogeneous,
    incompressible,
    manufactured,
    meshes,
    published,
    recovery,
    rigid,
    time_steps,
    twisted_beam,
)
from .problem import HardCase, HardOutcome, Outcome, Problem, run, run_hard

PUBLISHED = (cook, published, incompressible, twisted_beam)
ALL: tuple[Problem, ...] = (
    *rigid.PROBLEMS,
    *homogeneous.PROBLEMS,
    *bars.PROBLEMS,
    *(problem for module in PUBLISHED for problem in module.PROBLEMS),
)
FINE: tuple[Problem, ...] = tuple(problem for module in PUBLISHED for problem in module.FINE)
"""The published problems on finer meshes, half a minute each; the finest beam takes minutes."""
HARD: tuple[HardCase, ...] = (
    *recovery.CASES,
    *homogeneous.CASES,
    *bars.CASES,
    *time_steps.CASES,
)


def added_problems() -> tuple[Problem, ...]:
    """The problems of laws that files have added."""
    return tuple(problem for law in added_laws().values() for problem in law.problems)


__all__ = [
    "ALL",
    "FINE",
    "HARD",
    "HardCase",
    "HardOutcome",
    "Outcome",
    "Problem",
    "added_problems",
    "manufactured",
    "meshes",
    "run",
    "run_hard",
]
