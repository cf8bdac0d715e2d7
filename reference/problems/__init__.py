"""Verification problems: closed forms and published values, each a scene, a quantity and its value; and hard cases.

Sources are numbered. Problems: V2 homogeneous stretches, V3 time steps, V9 the thick sphere, V14 orders of convergence.
Hard cases: H1 random starts, H2 collapse, H3 inversion, H4 flat tets and slivers, H5 large stretches, H6 a twist near
incompressibility, H7 crushed and released, H8 locking, H9 stiffnesses that differ much, H11 time steps of any length,
H14 loads without a stable equilibrium.
"""

from ..added import added_laws
from . import (
    bars,
    cook,
    homogeneous,
    incompressible,
    laws_on_elements,
    manufactured,
    meshes,
    published,
    recovery,
    rigid,
    time_steps,
)
from .problem import HardCase, HardOutcome, Outcome, Problem, run, run_hard

PUBLISHED = (cook, published, incompressible)
ALL: tuple[Problem, ...] = (
    *rigid.PROBLEMS,
    *homogeneous.PROBLEMS,
    *bars.PROBLEMS,
    *(problem for module in PUBLISHED for problem in module.PROBLEMS),
)
FINE: tuple[Problem, ...] = tuple(problem for module in PUBLISHED for problem in module.FINE)
"""The published problems on finer meshes, half a minute each."""
HARD: tuple[HardCase, ...] = (
    *recovery.CASES,
    *homogeneous.CASES,
    *bars.CASES,
    *time_steps.CASES,
    *incompressible.CASES,
)
LAWS_ON_ELEMENTS: tuple[HardCase, ...] = laws_on_elements.CASES
"""Hard cases for every law on every element of FEniCSx: a quarter of an hour."""


def added_problems() -> tuple[Problem, ...]:
    """The problems of laws that files have added."""
    return tuple(problem for law in added_laws().values() for problem in law.problems)


def added_hard_cases() -> tuple[HardCase, ...]:
    """The hard cases of laws that files have added: those of LAWS_ON_ELEMENTS."""
    return tuple(case for law in added_laws() for case in laws_on_elements.cases_of(law))


__all__ = [
    "ALL",
    "FINE",
    "HARD",
    "LAWS_ON_ELEMENTS",
    "HardCase",
    "HardOutcome",
    "Outcome",
    "Problem",
    "added_hard_cases",
    "added_problems",
    "cook",
    "manufactured",
    "meshes",
    "run",
    "run_hard",
]
