"""In which order strategies are tried: a plan is data, and `follow` carries it out.

There are three. "minimise" is Newton's method on the energy, with projection and line search: it gets from anywhere to
some minimum. "augmented Lagrangian" does so for elements with a pressure, by minimisations between which the pressure
is corrected. "continuation" solves the equations of equilibrium and lets load and motion grow: it stays on the path
that the body takes, knows forces without an energy, and tells limit points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..solution import Reason
from .run import Attempt

GIVEN_UP = (Reason.LINE_SEARCH, Reason.LINEAR_SOLVER)


@dataclass(frozen=True)
class Step:
    """A strategy, and the reasons to stop after which the next one is tried."""

    strategy: str
    leaves: tuple[Reason, ...] = GIVEN_UP


Plan = tuple[Step, ...]

BODIES: Plan = (Step("minimise", leaves=()),)
FOLLOWER_PRESSURE: Plan = (Step("continuation", leaves=()),)
DISPLACEMENT: Plan = (Step("minimise"), Step("continuation"))


def mixed(*, path_first: bool, loaded: bool) -> Plan:
    """The plan of an element with a pressure; a limit point without dead loads is no reason to stop."""
    leaves = GIVEN_UP if loaded else (*GIVEN_UP, Reason.LIMIT_POINT)
    names = ("continuation", "augmented Lagrangian") if path_first else ("augmented Lagrangian", "continuation")
    return tuple(Step(name, leaves) for name in names)


def follow(plan: Plan, attempt: Callable[[str], Attempt]) -> Attempt:
    """Try a plan's strategies until one ends the search; the last that found something worth keeping, or the first.

    A path that ends where others branch off leaves what descent has found beyond it.
    """
    best: Attempt | None = None
    for step in plan:
        end = attempt(step.strategy)
        if best is None or not best.sound or end.reason not in (*GIVEN_UP, Reason.BIFURCATION):
            best = end
        if end.reason not in step.leaves and not end.doubtful:
            break
    assert best is not None
    return best
