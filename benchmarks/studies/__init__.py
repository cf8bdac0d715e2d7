"""The studies by name, and the commands under which several share a subject."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from ...lhm.base.errors import InputError

if TYPE_CHECKING:
    from ..harness.study import Study

STUDIES = {
    "agreement": "agreement.study:Agreement",
    "verification": "verification:Verification",
    "hard": "verification:Hard",
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
    "registration": "heads.registration:Registrations",
    "depth": "heads.depth:Depth",
    "closures": "heads.closures:Closures",
}
"""Module and class, so that none is loaded before it is asked for."""
SUBJECTS: dict[str, tuple[str, dict[str, str]]] = {
    "verification": (
        "Does every solver meet closed forms, published values and hard cases?",
        {"values": "verification", "hard": "hard"},
    ),
    "heads": (
        "Does every person get a valid head, and how near is it to what is known?",
        {"fit": "heads", "shapes": "shapes", "registration": "registration", "depth": "depth", "closures": "closures"},
    ),
    "scaling": (
        "What do time and memory cost by size, processes and incompressibility?",
        {
            "size": "scaling",
            "unknowns": "unknowns",
            "ranks": "ranks",
            "parts": "parts",
            "throughput": "throughput",
            "mixed": "mixed",
        },
    ),
    "mesh": (
        "How large are the errors of the mesh?",
        {"convergence": "convergence", "locking": "locking"},
    ),
}
"""Commands of several studies, with their question, and the study of each case; the first case is the default."""

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


def commands() -> tuple[str, ...]:
    """The names of the commands: subjects, and studies that are no case of one."""
    cases = {name for _, of in SUBJECTS.values() for name in of.values()}
    return (*SUBJECTS, *(name for name in names() if name not in cases))


def study_of(name: str) -> type[Study]:
    """The class of a study. InputError for a name that there is not."""
    if name in _added:
        return _added[name]
    if name not in STUDIES:
        raise InputError(f"study {name!r}: not here; `softdeca bench --add FILE` brings one of your own")
    module, _, kind = STUDIES[name].partition(":")
    found: type[Study] = getattr(import_module(f".{module}", __package__), kind)
    return found
