"""The studies, a file each, by the name of their command."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from ...lhm.base.errors import InputError

if TYPE_CHECKING:
    from ..harness.study import Study

STUDIES = {
    "agreement": "agreement.study:Agreement",
    "verification": "verification:Verification",
    "hard": "hard:Hard",
    "mixed": "scaling.mixed:Mixed",
    "split": "split:Split",
    "surrogate": "surrogate:SurrogateOnCorpus",
    "work-precision": "work_precision.study:WorkPrecision",
    "throughput": "scaling.throughput:Throughput",
    "scaling": "scaling.iterations:Scaling",
    "minimal": "minimal:Minimal",
    "unknowns": "scaling.unknowns:Unknowns",
    "convergence": "mesh.convergence:Convergence",
    "locking": "mesh.locking:Locking",
    "effects": "effects.study:Effects",
    "dynamics": "dynamics.study:Dynamics",
    "ranks": "scaling.ranks:Ranks",
    "parts": "scaling.parts:Parts",
    "material": "material:Material",
    "shapes": "heads.shapes:Shapes",
    "heads": "heads.fit:Heads",
    "depth": "heads.depth:Depth",
}
"""Module and class, so that none is loaded before it is asked for."""

_added: dict[str, type[Study]] = {}


def add_study(kind: type[Study]) -> type[Study]:
    """Let `softdeca bench` have a study of a file of one's own; a decorator. InputError for a name that is taken."""
    if kind.name in names():
        raise InputError(f"study {kind.name!r} is there already")
    _added[kind.name] = kind
    return kind


def names() -> tuple[str, ...]:
    """The names of all studies, with those that files have added."""
    return (*STUDIES, *_added)


def study_of(name: str) -> type[Study]:
    """The class of a study."""
    if name in _added:
        return _added[name]
    module, _, kind = STUDIES[name].partition(":")
    found: type[Study] = getattr(import_module(f".{module}", __package__), kind)
    return found
