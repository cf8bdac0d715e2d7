"""Who enters the arena: solvers of METHODS, of files of other packages, and those that a file has added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ....lhm.base.errors import InputError
from ....reference.added import added_solvers
from ....reference.face.facial import PD_ENERGY, FaceLaw
from ....surrogate import methods as m
from .laws import ISOCHORIC, NEO_HOOKEAN, PLAIN_STABLE, PROJECTIVE, RIGID, ST_VENANT
from .solvers import NAMES
from .solvers.__main__ import load
from .solvers.protocol import SolverFile

DEFAULT = "default"
"""The setting of a solver of ours by its own law."""
LAW_OF: Mapping[FaceLaw, str] = {PD_ENERGY: PROJECTIVE, m.NEO_HOOKEAN: NEO_HOOKEAN}
"""The arena's names of laws of METHODS."""
ALSO: Mapping[str, Sequence[str]] = {
    m.PD: (RIGID,),
    m.PD_PLAIN: (RIGID,),
    m.PD_ANDERSON: (RIGID,),
    m.FENICSX: (ST_VENANT, PLAIN_STABLE, ISOCHORIC, RIGID),
}
"""Laws that solvers of ours enter by besides, so that each other package has a rival of the same energy."""


@dataclass(frozen=True, eq=False)
class Entrant:
    """A solver by one setting: its law as `laws.LAWS` has it, or "" for one of its own.

    options: of `prepare`, or of the `file` of another package, which is a name in `solvers` or a path; the `packages`
    that this needs, as pip names them. tolerance [mm]: how near to a hanging bar's answer it ends.
    """

    solver: str
    setting: str
    law: str
    options: Mapping[str, Any]
    dtype: str = "float64"
    file: str = ""
    packages: Sequence[str] = field(default=())
    tolerance: float = float("inf")

    @property
    def element(self) -> str:
        """Its element."""
        element: str = self.options.get("element", "P1") if not self.file else "P1"
        return element


def list_entrants(files: Sequence[str] = ()) -> list[Entrant]:
    """List who enters, with files of one's own: other packages, then METHODS by their laws, then added solvers.

    InputError for a file that cannot be loaded.
    """
    outside = [
        Entrant(each.TITLE, setting, each.LAW, options, each.DTYPE, name, each.PACKAGES, each.TOLERANCE)
        for name in (*NAMES, *files)
        for each in (load_file(name),)
        for setting, options in each.SETTINGS.items()
    ]
    own: dict[str, Entrant] = {}
    for method in m.METHODS.values():
        if (solver := method.solver) is not None:
            # Cells are the problem's, so that a method of a face's tets is here the one of its prisms.
            own.setdefault(f"{solver.law} {solver.how}", Entrant(method.name, DEFAULT, LAW_OF[solver.law], solver.how))
    also = [Entrant(each.solver, law, law, each.options) for each in own.values() for law in ALSO.get(each.solver, ())]
    added = [Entrant(name, DEFAULT, NEO_HOOKEAN, {"solver": name}) for name in added_solvers()]
    return [*outside, *own.values(), *also, *added]


_loaded: dict[str, SolverFile] = {}


def load_file(name: str) -> SolverFile:
    """Load a solver's file once per process; InputError for one that cannot be loaded or lacks a name."""
    if name not in _loaded:
        try:
            module: Any = load(name)
        except (Exception, SystemExit) as error:
            raise InputError(f"solver {name}: {type(error).__name__}: {error}") from error
        lacks = [key for key in (*SolverFile.__annotations__,) if not hasattr(module, key)]
        if lacks:
            raise InputError(f"solver {name}: it defines no {', '.join(lacks)}; see docs/arena.md")
        _loaded[name] = module
    return _loaded[name]
