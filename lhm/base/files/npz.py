"""Arrays in .npz files: written whole or not at all, and read with errors that name the file."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError, one_line
from ..limits import UNPACKED_BYTES
from .atomic import write_whole
from .text import check_file, read_bytes


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name, compressed; InputError if the file cannot be written, and then it is as it was.

    Its name has to end in .npz, since readers tell files by their ending.
    """
    if Path(path).suffix != ".npz":
        raise InputError(f"{path}: expected a file that ends in .npz")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_whole(path, buffer.getvalue())


def read_arrays(path: str | os.PathLike[str], *names: str, kind: str = "an .npz file") -> dict[str, np.ndarray]:
    """Read the arrays of these names, or all; `kind` is what the file should be.

    Arrays hold no objects. Raises InputError, one line that names the file, if it is missing, damaged, too large, or
    lacks an array.
    """
    path = Path(path)
    try:
        if not zipfile.is_zipfile(check_file(path)):
            raise InputError(f"{path}: not {kind}, or damaged (no .npz file, or its end is missing)")
        with zipfile.ZipFile(path) as archive:
            members = {part.filename.removesuffix(".npy"): part for part in archive.infolist()}
            UNPACKED_BYTES.check("it holds", sum(part.file_size for part in members.values()))
            missing = [name for name in names if name not in members]
            arrays = {}
            for name in [] if missing else names or list(members):
                with archive.open(members[name]) as file:
                    arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
                    file.read()  # to its end, where the checksum is compared
    except Exception as error:  # zipfile, zlib and numpy raise whatever the damage makes them raise
        if isinstance(error, InputError) and str(error).startswith(one_line(str(path))):
            raise
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{path}: not {kind}, or damaged ({reason})") from None
    if missing:
        raise InputError(f"{path}: not {kind}, array {missing[0]!r} is missing")
    return arrays


def read_npy(path: Path) -> np.ndarray:
    """Read an .npy file; InputError names one that is missing or damaged."""
    content = read_bytes(path)
    try:
        return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy raises whatever the damage makes it raise
        raise InputError(f"{path}: no .npy file, or damaged ({' '.join(str(error).split())[:100]})") from None
