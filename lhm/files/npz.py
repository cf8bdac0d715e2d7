"""Arrays in .npz files: written whole or not at all, and read with errors that name the file."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError
from .atomic import write_whole

MOST_BYTES = 2_000_000_000
"""What a file may unpack to: far above the largest template, and below what a small machine has."""


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name, compressed; InputError if the file cannot be written, and then it is as it was.

    Its name has to end in .npz, since readers tell files by their ending.
    """
    if Path(path).suffix != ".npz":
        raise InputError(f"{path}: expected a file that ends in .npz")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_whole(path, buffer.getvalue())


def read_arrays(path: str | os.PathLike[str], *names: str, of: str = "an .npz file") -> dict[str, np.ndarray]:
    """The arrays of these names, or all; `of` is what the file should be.

    Raises InputError, one line that names the file, if it is missing, damaged, or lacks an array.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path}: not {of}, or damaged (no .npz file, or its end is missing)")
    try:
        with zipfile.ZipFile(path) as whole:
            size = sum(part.file_size for part in whole.infolist())
        if size > MOST_BYTES:
            raise ValueError(f"it unpacks to {size / 1e9:.1f} GB, expected at most {MOST_BYTES / 1e9:.0f} GB")
        with np.load(path, allow_pickle=False) as file:
            missing = [name for name in names if name not in file.files]
            arrays = {} if missing else {name: file[name] for name in names or file.files}
    except Exception as error:  # zipfile, zlib and numpy raise whatever the damage makes them raise
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise InputError(f"{path}: not {of}, or damaged ({reason})") from None
    if missing:
        raise InputError(f"{path}: not {of}, array {missing[0]!r} is missing")
    return arrays
