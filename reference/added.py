"""Laws and solvers that files of one's own add: studies then have them beside those of the package."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from ..lhm.base.errors import InputError, SceneError, quote
from .materials import LAWS, EnergyLaw
from .materials.consistency import check_law

if TYPE_CHECKING:
    from .problems.problem import Problem

SOLVERS = ("projective", "fenicsx", "skfem")
HOUSE_LAWS = ("PD", "Strain + Volume", *(law.__name__ for law in LAWS))
"""Names that studies have for laws of their own."""


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
    Raises InputError for a file that is missing, has the name of another one, raises anything itself, or ends the
    process, which would look as if all had been done.
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
        with _refuse_exit(path):
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise InputError(f"{path}: {type(error).__name__}: {error}") from error
    except BaseException:  # Ctrl-C
        del sys.modules[name]
        raise
    _files[name] = path


@contextmanager
def _refuse_exit(path: Path) -> Iterator[None]:
    """Let os._exit raise while a file is run: it would end the process without a word."""
    ends = os._exit

    def refuse(status: int) -> NoReturn:
        raise InputError(f"it ends the process (os._exit({status}))")

    os._exit = refuse
    try:
        yield
    finally:
        os._exit = ends


def added_files() -> tuple[Path, ...]:
    """The files that were added, in order."""
    return tuple(_files.values())


def add_law(name: str, of_moduli: Callable[[float, float], EnergyLaw], problems: tuple[Problem, ...] = ()):
    """Let studies have a law of Lamé's moduli mu and lmbda [kPa] at rest.

    Verification has its `problems` beside those that every law has, hard cases have it on every element, and
    work-precision a face of it. Raises InputError for a name that is taken, for what is no EnergyLaw of these moduli at
    rest, and for one whose energy, derivatives and densities do not agree (`materials.consistency`).
    """
    if name in _laws:
        raise InputError(f"law {name!r} was added already")
    if not (isinstance(name, str) and name.strip() and name.isprintable()):
        raise InputError(f"law {quote(name)}: expected a name of printable characters")
    if _plain(name) in map(_plain, HOUSE_LAWS):
        raise InputError(f"law {name!r}: a law of this name is there already")
    for moduli in ((1.0, 9.0), (0.4, 3.1)):  # two: a power of a modulus is 1 at 1 kPa
        try:
            law = of_moduli(*moduli)
        except Exception as error:
            raise InputError(f"law {name!r}: of moduli {moduli} kPa: {type(error).__name__}: {error}") from error
        if not isinstance(law, EnergyLaw):
            raise InputError(f"law {name!r}: expected an EnergyLaw, got {type(law).__name__}")
        if not all(abs(a - b) < 1e-9 for a, b in zip(law.lame, moduli, strict=True)):
            raise InputError(f"law {name!r}: of moduli {moduli} kPa it has {law.lame} at rest")
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
