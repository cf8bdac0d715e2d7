"""Verification problems: closed forms and published values, each a scene, a quantity and its value; and hard cases."""

from . import bars, homogeneous, meshes, recovery, rigid, stretched_bars, stretched_laws, time_steps, twisted_bar
from .hard_case import HardCase, HardOutcome, run_hard
from .problem import Outcome, Problem, run

ALL: tuple[Problem, ...] = (*rigid.PROBLEMS, *homogeneous.PROBLEMS, *stretched_laws.PROBLEMS, *bars.PROBLEMS)
HARD: tuple[HardCase, ...] = (*recovery.CASES, *stretched_bars.CASES, *twisted_bar.CASES, *time_steps.CASES)

__all__ = ["ALL", "HARD", "HardCase", "HardOutcome", "Outcome", "Problem", "meshes", "run", "run_hard"]
