"""What every solver of the arena has to do: stay where nothing acts, follow what holds it, and hang as it says.

Springs too, where it takes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ....reference import terms
from ....reference.materials.material import lame
from ....reference.problems.meshes import block, vertices_at
from ..measures import TIGHT, solve_to_end
from . import problems
from .contest import check, run_outside, summarise
from .laws import NEO_HOOKEAN
from .problems import Problem
from .study import load_file

STILL_MM, FOLLOWS_MM = 1e-3, 0.05
"""[mm] that a block may move of itself, and be away from where its held end was carried by 4 mm."""


@dataclass(frozen=True)
class Finding:
    """Distance of a solver's end from the answer, and its bound [mm]; None where it had no end."""

    what: str
    away_mm: float | None
    bound_mm: float

    @property
    def passed(self) -> bool:
        """Whether it is near enough."""
        return self.away_mm is not None and self.away_mm <= self.bound_mm


def conform(name: str, budget: float = 3.0) -> list[Finding]:
    """Run a solver's file (a name in `solvers`, or a path) on three small problems, by its best setting.

    A block with a held end that nothing acts on, the same block carried along by that end, one that springs pull for a
    solver that takes them, and the hanging bar. Raises NotModelledError for a problem that the solver refuses, and
    MissingDependencyError without its packages.
    """
    file = load_file(name)
    still, carried = _block(np.zeros(3)), _block(np.array([3.0, 2.0, 1.0]))
    tests: list[tuple[str, Problem, np.ndarray, float]] = [
        ("a block that is left alone", still, still.vertices, STILL_MM),
        ("a block that is carried along", carried, carried.vertices + [3.0, 2.0, 1.0], FOLLOWS_MM),
    ]
    law = file.LAW or NEO_HOOKEAN
    if "springs" in getattr(file, "TAKES", ()) and file.LAW:
        pulled = _pull(still)
        end = solve_to_end(pulled.scene(law), f"springs, {law}", solver="fenicsx", tolerance=TIGHT).positions
        tests.append(("a block that springs pull", pulled, end, FOLLOWS_MM))
    if np.isfinite(file.TOLERANCE):
        tests.append(("a hanging bar", problems.make("bar"), problems.answer("bar", law), file.TOLERANCE))
    return [Finding(what, _end(name, problem, answer, budget), bound) for what, problem, answer, bound in tests]


def _end(name: str, problem: Problem, answer: np.ndarray, budget: float) -> float | None:
    """The largest distance [mm] to an answer at the end of the best setting."""
    file, answers = load_file(name), {"own": answer, "neo": answer}
    ends = []
    for settings in file.SETTINGS.values():
        lines = run_outside(name, problem.arrays(), answers, settings, budget)
        check(lines, file.TITLE, file.PACKAGES)
        values: Mapping = summarise(lines)
        if values["max_mm"] is not None:
            ends.append(values["max_mm"])
    return min(ends, default=None)


def _pull(problem: Problem) -> Problem:
    """Draw the top of a block aside by springs of two stiffnesses."""
    top = vertices_at(problem.vertices, 2, 20.0)
    goal = problem.vertices[top] + [2.0, -1.0, 1.0]
    stiffness = np.where(np.arange(len(top)) % 2, 5.0, 20.0)
    return replace(problem, loads=[terms.Target(top, goal, stiffness)])


def _block(shift: np.ndarray) -> Problem:
    """A soft cube of 20 mm whose bottom is held where it is, moved by so much [mm]."""
    X, tets = block(3, 20.0)
    mu, lmbda = lame(problems.FLESH_YOUNG, problems.FLESH_POISSON)
    held, full = vertices_at(X, 2, 0.0), np.ones(len(tets))
    return Problem(X, tets, held, X[held] + shift, [], mu * full, lmbda * full, np.arange(len(X)))
