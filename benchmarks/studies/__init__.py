"""The studies by name, under the questions that they answer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from ...lhm.base.errors import InputError, quote

if TYPE_CHECKING:
    from ..harness.study import Study

QUESTIONS: Mapping[str, Mapping[str, str]] = {
    "How far is each method, and what does it cost?": {
        "faces": "faces:Faces",
    },
    "Is the fast simulator right?": {
        "agreement": "agreement.study:Agreement",
        "verification": "verification:Verification",
        "contact": "agreement.contact:Contact",
    },
    "Where is it wrong?": {
        "hard": "verification:Hard",
        "material": "agreement.material:Material",
        "mesh": "mesh.study:MeshError",
        "face-benchmark": "mesh.face:FaceBenchmark",
    },
    "How far is the network from it?": {
        "surrogate": "surrogate.study:SurrogateOnCorpus",
        "split": "surrogate.split:Split",
        "dial": "surrogate.dial:Dial",
    },
    "What does each method cost?": {
        "work-precision": "arena.study:WorkPrecision",
        "arena": "arena.study:Arena",
        "throughput": "scaling.throughput:Throughput",
        "unknowns": "scaling.unknowns:Unknowns",
        "ranks": "scaling.ranks:Ranks",
    },
    "What can a scene leave out?": {
        "minimal": "scaling.minimal:Minimal",
    },
    "Which heads work?": {
        "heads": "heads.fit:Heads",
        "depth": "heads.depth:Depth",
    },
}
"""A reader's questions, and the studies that answer each, in the order of lists and reports.

A study is a module and a class, so that none is loaded before it is asked for.
"""
OTHER = "What else was measured?"
"""Studies of a user's own files."""
STUDIES = {name: place for studies in QUESTIONS.values() for name, place in studies.items()}

_added: dict[str, type[Study]] = {}


def add_study(kind: type[Study]) -> type[Study]:
    """Let `softdeca bench` have a study of a file of one's own; a decorator. InputError for a name that is taken."""
    if kind.name in list_studies():
        raise InputError(f"study {kind.name!r} is there already")
    _added[kind.name] = kind
    return kind


def list_studies() -> tuple[str, ...]:
    """Name all studies, with those that files have added."""
    return (*STUDIES, *_added)


def group_studies(names: Collection[str]) -> dict[str, list[str]]:
    """Group names of studies by the questions that they answer, in the order of QUESTIONS; own ones come last."""
    groups = {question: [name for name in ours if name in names] for question, ours in QUESTIONS.items()}
    groups[OTHER] = [name for name in names if name not in STUDIES]
    return {question: studies for question, studies in groups.items() if studies}


def load_study(name: str) -> type[Study]:
    """Give the class of a study. InputError for a name that there is not."""
    if name in _added:
        return _added[name]
    if name not in STUDIES:
        raise InputError(f"study {quote(name)!r}: not here; `softdeca bench --add FILE` brings one of your own")
    module, _, kind = STUDIES[name].partition(":")
    study: type[Study] = getattr(import_module(f".{module}", __package__), kind)
    return study
