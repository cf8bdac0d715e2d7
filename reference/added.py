"""Laws, with problems that check them, and solvers that files of one's own add, beside those of the package."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..lhm.base.errors import InputError, SceneError, quote
from ..lhm.base.mesh import Floats
from .materials import LAWS, EnergyLaw
from .materials.consistency import check_law
from .scene import Scene
from .solution import Reason, Solution

SOLVERS = ("projective", "fenicsx", "skfem")
HOUSE_LAWS = ("PD", "Strain + Volume", *(law.__name__ for law in LAWS))
"""Names that studies have for laws of their own."""
TOLERANCE = 1e-11
"""The relative gradient norm that problems are solved to."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene, a quantity of its solution, and the value that it must have.

    `bounds` gives, for each solver that models the scene, the largest error that passes: relative to the reference,
    or absolute where that is 0. `start` gives positions [mm] to start from, default rest; `options`
    are the solver's, such as its element; `reason` is why the solver should stop.
    """

    name: str
    source: str
    scene: Callable[[], Scene]
    quantity: Callable[[Scene, Solution], float]
    reference: float
    bounds: Mapping[str, float]
    start: Callable[[Scene], Floats] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    tolerance: float = TOLERANCE
    reason: Reason = Reason.CONVERGED

    @property
    def solvers(self) -> tuple[str, ...]:
        """The solvers that model the problem, and those that files have added, which say themselves if they do not."""
        return (*self.bounds, *(() if self.options else added_solvers()))

    def bound(self, solver: str) -> float:
        """The largest error that passes; of a solver that a file has added, the largest of any."""
        return self.bounds.get(solver, max(self.bounds.values()))


@dataclass(frozen=True)
class AddedLaw:
    """A law of Lamé's moduli mu and lmbda [kPa] at rest, and the problems that say whether solvers have it right."""

    of_moduli: Callable[[float, float], EnergyLaw]
    problems: tuple[Problem, ...]


_files: dict[str, Path] = {}
_laws: dict[str, AddedLaw] = {}
_solvers: dict[str, Callable[..., Any]] = {}


def add_file(path: Path | str):
    """Run a Python file, which adds laws (`add_law`), solvers (`add_solver`) or studies; once, if asked twice.

    Its classes are those of a module "softdeca_added_" and the file's name, also in processes that a study starts.
    Raises InputError for a file that is missing, has the name of another one, or raises anything itself.
    """
    path = Path(path).resolve()
    name = f"softdeca_added_{path.stem}"
    if not path.is_file() or path.suffix != ".py":
        raise InputError(f"{path}: there is no such Python file")
    if name in _files:
        if _files[name] != path:
            raise InputError(f"{path}: a file of this name was added already, {_files[name]}")
        return
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        sys.modules.pop(name, None)
        if isinstance(error, KeyboardInterrupt):
            raise
        raise InputError(f"{path}: {type(error).__name__}: {error}") from error
    _files[name] = path


def added_files() -> tuple[Path, ...]:
    """The files that were added, in order."""
    return tuple(_files.values())


def add_law(name: str, of_moduli: Callable[[float, float], EnergyLaw], problems: tuple[Problem, ...] = ()):
    """Let studies have a law of Lamé's moduli mu and lmbda [kPa] at rest.

    Verification has its `problems`, work-precision a face of it, material a cube, and agreement faces, by `--law`.
    Raises InputError for a name that is taken, for what is no EnergyLaw of these moduli at rest, and for one whose
    formula is no energy of them (`materials.consistency`).
    """
    if name in _laws:
        raise InputError(f"law {name!r} was added already")
    if not (isinstance(name, str) and name.strip() and name.isprintable()):
        raise InputError(f"law {quote(name)}: expected a name of printable characters")
    if not isinstance(problems, (tuple, list)) or not all(isinstance(each, Problem) for each in problems):
        raise InputError(f"law {name!r}: problems: expected a tuple of Problem, got {quote(problems)}")
    if _plain(name) in map(_plain, HOUSE_LAWS):
        raise InputError(f"law {name!r}: a law of this name is there already")
    for moduli in ((1.0, 9.0), (0.4, 3.1)):  # two: a power of a modulus is 1 at 1 kPa
        try:
            law = of_moduli(*moduli)
            lame = tuple(map(float, law.lame)) if isinstance(law, EnergyLaw) else ()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit would end the process as if all had been done
            raise InputError(
                f"law {name!r}: of moduli {moduli} kPa: {type(error).__name__}: {quote(str(error), 100)}"
            ) from error
        if not isinstance(law, EnergyLaw):
            raise InputError(f"law {name!r}: expected an EnergyLaw, got {type(law).__name__}")
        if len(lame) != 2 or not all(abs(a - b) < 1e-9 for a, b in zip(lame, moduli, strict=True)):
            raise InputError(f"law {name!r}: of moduli {moduli} kPa it has {quote(lame)} at rest")
        check_law(name, law)
    _laws[name] = AddedLaw(of_moduli, tuple(problems))


def _plain(name: str) -> str:
    return "".join(filter(str.isalnum, name.lower()))


def added_laws() -> Mapping[str, AddedLaw]:
    """The laws that were added, by name."""
    return _laws


def add_solver(name: str, prepare: Callable[..., Any]):
    """Let `prepare`, `solve` and studies have a solver: `prepare(scene, **options)` gives what `Prepared` describes.

    It raises SceneError for a scene that it cannot model, best by `refuse_unknown`; studies then leave that case out.
    Raises InputError for a name that is taken.
    """
    if name in SOLVERS or name in _solvers:
        raise InputError(f"solver {name!r} is there already")
    _solvers[name] = prepare


def added_solvers() -> Mapping[str, Callable[..., Any]]:
    """The `prepare` of each solver that was added, by name."""
    return _solvers


def all_solvers() -> tuple[str, ...]:
    """The names that `prepare` takes: those that are here, and those that files have added."""
    return (*SOLVERS, *_solvers)


class NotModelledError(SceneError):
    """A solver that was added cannot model a scene; studies leave the case out, as they do without a package."""
