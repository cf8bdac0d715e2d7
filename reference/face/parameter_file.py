"""Parameters p from a TOML file: names with numbers, or with the .npy file of a parameter that varies over the face.

soft_stiffness = 4.0
gravity = 1.5
skin_stiffness = "cheek.npy"     # one value per triangle of the wraps; beside this file
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ...lhm.base.checks import check_arguments, finite
from ...lhm.base.errors import InputError, escape, quote
from ...lhm.base.files.text import read_toml
from ...lhm.base.mesh import Floats
from .parameters import Parameters


@check_arguments
def read_parameters(path: str | os.PathLike[str]) -> Parameters:
    """The parameters in a TOML file; what it does not name keeps its default.

    Raises InputError, one line that names the file and the parameter, for a file that is missing or no TOML, an unknown
    name, and a value that is no number or out of range.
    """
    path = Path(path)
    named = read_toml(path)
    try:
        values = {Parameters.info(name).name: _value(path, name, value) for name, value in named.items()}
        return Parameters(**values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _value(path: Path, name: str, value):
    """A number as it is (Parameters checks it), or the array in the file that a text names."""
    return _array(path.parent / value, name) if isinstance(value, str) else value


def _array(path: Path, name: str) -> Floats:
    if path.suffix != ".npy" or not os.path.isfile(path):  # False, too, for a name that is too long
        raise InputError(f"parameter {name}: {quote(str(path), 200)}: expected a number, or an .npy file that is there")
    try:
        # A map of the file cannot be longer than the file, whatever its header says.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # numpy's reader raises whatever the damage makes it raise
        reason = escape(" ".join(str(error).split()))[:60]
        raise InputError(f"parameter {name}: {path}: not an array of numbers ({reason})") from None
    values = np.array(finite(f"parameter {name}: {path}", array))
    try:
        Parameters(**{Parameters.info(name).name: values})  # type: ignore[arg-type]  # one of those that may vary
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return values
