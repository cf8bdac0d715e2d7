"""Arrays from .npz files, and files that are not what they should be."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from .errors import InputError


def read_arrays(path: str | os.PathLike[str], *names: str, of: str = "an .npz file") -> dict[str, np.ndarray]:
    """The arrays of these names, or all; `of` is what the file should be.

    Raises InputError, one line that names the file, if it is missing, damaged, or lacks an array.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as file:
            missing = [name for name in names if name not in file.files]
            arrays = {} if missing else {name: file[name] for name in names or file.files}
    except Exception as error:  # zipfile, zlib and numpy raise whatever the damage makes them raise
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise InputError(f"{path}: not {of}, or damaged ({reason})") from None
    if missing:
        raise InputError(f"{path}: not {of}, array {missing[0]!r} is missing")
    return arrays
