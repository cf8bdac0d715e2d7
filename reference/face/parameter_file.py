"""Parameters p from a TOML file: names with numbers, or with the .npy file of a parameter that varies over the face.

soft_stiffness = 4.0
gravity = 1.5
skin_stiffness = "cheek.npy"     # one value per triangle of the wraps; beside this file
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ...lhm.checked import checked
from ...lhm.errors import InputError
from ...lhm.files.toml_file import read_toml
from ...lhm.mesh import Floats
from .parameters import Parameters


@checked
def read_parameters(path: str | os.PathLike[str]) -> Parameters:
    """The parameters in a TOML file; what it does not name keeps its default.

    Raises InputError, one line that names the file and the parameter, for a file that is missing or no TOML, an unknown
    name, and a value that is no number or out of range.
    """
    path = Path(path)
    named = read_toml(path)
    try:
        return Parameters(**{Parameters.info(name).name: _value(path, name, value) for name, value in named.items()})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _value(path: Path, name: str, value):
    """A number as it is (Parameters checks it), or the array in the file that a text names."""
    return _array(path.parent / value, name) if isinstance(value, str) else value


def _array(path: Path, name: str) -> Floats:
    if path.suffix != ".npy" or not path.is_file():
        raise InputError(f"parameter {name}: {path}: expected a number, or an .npy file that is there")
    try:
        array = np.load(path, allow_pickle=False)
        return np.asarray(array, dtype=np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"parameter {name}: {path}: not an array of numbers ({str(error)[:60]})") from None
