"""Verification problems: closed forms and published values, each a scene, a quantity and its value; and hard cases.

Sources are numbered. Problems: V2 homogeneous stretches, V3 time steps, V9 the thick sphere, V14 orders of convergence.
Hard cases: H1 random starts, H2 collapse, H3 inversion, H4 flat tets and slivers, H5 large stretches, H6 a twist near
incompressibility, H7 crushed and released, H11 time steps of any length,
H14 loads without a stable equilibrium.
"""

import functools
from collections.abc import Callable

from ..added import added_laws
from ..materials import EnergyLaw, lame
from ..terms import Hyperelastic
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

ROUNDING = {"fenicsx": 1e-10, "skfem": 1e-10}
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
    *incompressible.CASES,
)


def added_problems() -> tuple[Problem, ...]:
    """The problems of laws that files have added: their own, and those that only need a law."""
    return tuple(
        problem for name, law in added_laws().items() for problem in (*law.problems, *_problems_of(name, law.of_moduli))
    )


@functools.cache
def _problems_of(name: str, of_moduli: Callable[[float, float], EnergyLaw]) -> tuple[Problem, ...]:
    energies = (Hyperelastic(of_moduli(rigid.MU, 4.0 * rigid.MU)),)
    moved = rigid.problems_of(name, energies, ROUNDING, least_energy=1e-13)
    return (*moved, *homogeneous.problems_of(name, of_moduli(*lame(homogeneous.YOUNG, homogeneous.POISSON))))


def added_hard_cases() -> tuple[HardCase, ...]:
    """The hard cases of laws that files have added, of H1's moduli."""
    moduli = lame(recovery.YOUNG, recovery.POISSON)
    return tuple(case for name, law in added_laws().items() for case in recovery.cases_of(name, law.of_moduli(*moduli)))


__all__ = [
    "ALL",
    "FINE",
    "HARD",
    "HardCase",
    "HardOutcome",
    "Outcome",
    "Problem",
    "added_hard_cases",
    "added_problems",
    "manufactured",
    "meshes",
    "run",
    "run_hard",
]
