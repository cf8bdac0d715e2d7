"""The studies by name, and the commands under which several share a subject."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from ...lhm.base.errors import InputError, quote

if TYPE_CHECKING:
    from ..harness.study import Study

STUDIES = {
    "agreement": "agreement.study:Agreement",
    "verification": "verification:Verification",
    "hard": "verification:Hard",
    "mixed": "scaling.mixed:Mixed",
    "split": "surrogate.split:Split",
    "dial": "surrogate.dial:Dial",
    "table-1": "surrogate.table_1:Table1",
    "surrogate": "surrogate.study:SurrogateOnCorpus",
    "work-precision": "work_precision.study:WorkPrecision",
    "arena": "arena.study:Arena",
    "throughput": "scaling.throughput:Throughput",
    "scaling": "scaling.iterations:Scaling",
    "minimal": "scaling.minimal:Minimal",
    "unknowns": "scaling.unknowns:Unknowns",
    "convergence": "mesh.convergence:Convergence",
    "locking": "mesh.locking:Locking",
    "face-benchmark": "mesh.face:FaceBenchmark",
    "effects": "agreement.effects:Effects",
    "contact": "agreement.contact:Contact",
    "dynamics": "agreement.dynamics:Dynamics",
    "ranks": "scaling.ranks:Ranks",
    "parts": "scaling.parts:Parts",
    "timing": "scaling.timing:Timing",
    "corotated": "scaling.corotated:OperatorSplitting",
    "material": "agreement.material:Material",
    "shapes": "heads.shapes:Shapes",
    "heads": "heads.fit:Heads",
    "registration": "heads.registration:Registrations",
    "depth": "heads.depth:Depth",
    "closures": "heads.closures:Closures",
}
"""Module and class, so that none is loaded before it is asked for."""
COMMANDS: dict[str, tuple[str, dict[str, str]]] = {
    "agreement": (
        "How far apart are solvers, laws, network and rules: faces, effects, motion, a cube of tissue, contact?",
        {"faces": "agreement", "effects": "effects", "motion": "dynamics", "cube": "material", "contact": "contact"},
    ),
    "verification": (
        "Does every solver meet closed forms, published values and hard cases?",
        {"values": "verification", "hard": "hard"},
    ),
    "surrogate": (
        "How far is the network from the simulator on people it has not seen, and where does its error come from?",
        {"people": "surrogate", "split": "split", "dial": "dial", "table-1": "table-1"},
    ),
    "heads": (
        "Does every person get a valid head, and how near is it to what is known?",
        {"fit": "heads", "shapes": "shapes", "registration": "registration", "depth": "depth", "closures": "closures"},
    ),
    "scaling": (
        "What do time and memory cost by size, processes, incompressibility and pieces of the scene?",
        {
            "size": "scaling",
            "unknowns": "unknowns",
            "ranks": "ranks",
            "parts": "parts",
            "throughput": "throughput",
            "mixed": "mixed",
            "pieces": "minimal",
            "timing": "timing",
            "corotated": "corotated",
        },
    ),
    "mesh": (
        "How large are the errors of the mesh?",
        {"convergence": "convergence", "locking": "locking", "face": "face-benchmark"},
    ),
}
"""Commands of several studies, with their question, and the study of each case; the first case is the default."""

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


def list_commands() -> tuple[str, ...]:
    """Name the commands: subjects, and studies that are no case of one."""
    cases = {name for _, of in COMMANDS.values() for name in of.values()}
    return (*COMMANDS, *(name for name in list_studies() if name not in cases))


def describe_command(study: str) -> str:
    """Give the words that run a study, as `softdeca bench verification --cases hard`."""
    for subject, (_, cases) in COMMANDS.items():
        for number, (case, name) in enumerate(cases.items()):
            if name == study:
                return f"softdeca bench {subject}" + (f" --cases {case}" if number else "")
    return f"softdeca bench {study}"


def load_study(name: str) -> type[Study]:
    """Give the class of a study. InputError for a name that there is not."""
    if name in _added:
        return _added[name]
    if name not in STUDIES:
        raise InputError(f"study {quote(name)!r}: not here; `softdeca bench --add FILE` brings one of your own")
    module, _, kind = STUDIES[name].partition(":")
    found: type[Study] = getattr(import_module(f".{module}", __package__), kind)
    return found
