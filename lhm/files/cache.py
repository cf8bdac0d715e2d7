"""What is expensive to make is kept in the user's cache folder; a damaged file is made anew."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import platformdirs

from ..errors import InputError
from .npz import read_arrays, write_arrays

Arrays = Mapping[str, np.ndarray]


def folder() -> Path:
    """The cache folder: $SOFTDECA_CACHE, or the user's cache folder of this platform."""
    return Path(os.environ.get("SOFTDECA_CACHE") or platformdirs.user_cache_dir("softdeca"))


def cached(name: str, make: Callable[[], Arrays]) -> Arrays:
    """The arrays stored as `name`.npz, or made and stored if the file is missing, damaged or cannot be read.

    Where the folder cannot be written the arrays are made each time.
    """
    path = folder() / f"{name}.npz"
    try:
        return read_arrays(path)
    except InputError:
        arrays = make()
    try:
        write_arrays(path, arrays)
    except InputError:
        pass
    return arrays
