"""The studies, a file each, by the name of their command."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..harness.study import Study

STUDIES = {
    "verification": "verification:Verification",
    "hard": "hard:Hard",
    "mixed": "mixed:Mixed",
    "split": "split:Split",
    "surrogate": "surrogate:SurrogateOnCorpus",
    "work-precision": "work_precision:WorkPrecision",
    "throughput": "throughput:Throughput",
    "scaling": "scaling:Scaling",
    "minimal": "minimal:Minimal",
    "unknowns": "unknowns:Unknowns",
    "convergence": "convergence:Convergence",
    "effects": "effects:Effects",
    "dynamics": "dynamics:Dynamics",
    "ranks": "ranks:Ranks",
    "material": "material:Material",
    "shapes": "shapes:Shapes",
    "heads": "heads:Heads",
}
"""Module and class, so that none is loaded before it is asked for."""


def study_of(name: str) -> type[Study]:
    """The class of a study."""
    module, _, kind = STUDIES[name].partition(":")
    found: type[Study] = getattr(import_module(f".{module}", __package__), kind)
    return found
