"""The user's cache folder: arrays and compiled code that are expensive to make; a damaged file is made anew."""

from __future__ import annotations

import contextlib
import functools
import os
import stat
import tempfile
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numba
import numpy as np
import platformdirs

from ..errors import InputError, MeshError
from .npz import read_arrays, write_arrays

Arrays = Mapping[str, np.ndarray]
Made = TypeVar("Made")
OF = "cached as"
"""Names the array of a file's own name: a copy under another holds something else."""


def cache_folder() -> Path:
    """Return the cache folder, made and writable: $SOFTDECA_CACHE, or the user's cache folder of this platform.

    Where neither can be, a temporary folder of this user takes its place, and a warning says so once.
    """
    wanted = Path(os.environ.get("SOFTDECA_CACHE") or platformdirs.user_cache_dir("softdeca"))
    return wanted if is_writable(wanted) else _temporary(wanted)


def is_writable(path: Path) -> bool:
    """Return whether files can be put into a folder, which is made if missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(path, os.W_OK | os.X_OK)


@functools.cache
def _temporary(wanted: Path) -> Path:
    path = Path(tempfile.gettempdir()) / f"softdeca-cache-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        state = path.lstat()
        # Compiled code is run: the folder has to be this user's own.
        is_ours = stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid() and not state.st_mode & 0o022
    except OSError:
        is_ours = False
    path = path if is_ours else Path(tempfile.mkdtemp(prefix="softdeca-cache-"))
    warnings.warn(f"{wanted} cannot be written; caching in {path}", stacklevel=3)
    return path


def keep_compiled_functions() -> None:
    """Give numba a folder for what it compiles, where it can write neither beside the source nor in the user's cache.

    To be called before the first function that is to be kept: numba refuses to define one.
    """
    try:
        numba.njit(cache=True)(is_writable)
    except RuntimeError:
        numba.config.CACHE_DIR = str(cache_folder() / "numba")


def load_or_make(name: str, make: Callable[[], Arrays], read: Callable[[Arrays], Made] = dict) -> Made:  # type: ignore[assignment]
    """Return what `read` makes of the arrays stored as `name`.npz, by default the arrays themselves.

    They are made and stored if the file is missing, cannot be read, is of another name, or is damaged, for which `read`
    raises InputError or KeyError. Where the disk is full the arrays are made each time.
    """
    path = cache_folder() / f"{name}.npz"
    try:
        kept = read_arrays(path)
        if kept.pop(OF).tolist() == name:
            return read(kept)
    except (InputError, MeshError, KeyError):
        pass
    arrays = make()
    with contextlib.suppress(InputError):
        write_arrays(path, {**arrays, OF: np.array(name)})
    return read(arrays)
