"""Verification problems: closed forms and published values, each a scene, a quantity and its value; and hard cases."""

from ..added import added_laws
from . import (
    bars,
    beam,
    block,
    cook,
    flexure,
    homogeneous,
    laws_on_elements,
    limit_points,
    locking,
    manufactured,
    meshes,
    orders,
    recovery,
    rigid,
    slivers,
    stretched_bars,
    stretched_laws,
    thick_sphere,
    time_steps,
    torsion,
    twisted_bar,
)
from .hard_case import HardCase, HardOutcome, run_hard
from .problem import Outcome, Problem, run

PUBLISHED = (cook, block, beam, thick_sphere, flexure, torsion)
ALL: tuple[Problem, ...] = (
    *rigid.PROBLEMS,
    *homogeneous.PROBLEMS,
    *stretched_laws.PROBLEMS,
    *bars.PROBLEMS,
    *(problem for module in PUBLISHED for problem in module.PROBLEMS),
)
FINE: tuple[Problem, ...] = tuple(problem for module in PUBLISHED for problem in module.FINE)
"""The published problems on finer meshes, half a minute each."""
HARD: tuple[HardCase, ...] = (
    *recovery.CASES,
    *slivers.CASES,
    *stretched_bars.CASES,
    *twisted_bar.CASES,
    *time_steps.CASES,
    *limit_points.CASES,
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
    "locking",
    "manufactured",
    "meshes",
    "orders",
    "run",
    "run_hard",
]
