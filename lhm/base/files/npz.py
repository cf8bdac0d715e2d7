"""Arrays in .npz files: written whole or not at all, and read with errors that name the file."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np

from ..errors import InputError, one_line, quote
from ..limits import ARRAYS, UNPACKED_BYTES
from .atomic import write_whole
from .text import check_file, read_bytes

_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_KINDS = "biufcSU"


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

    Arrays are of numbers, True and False, or texts, and each is as large as the file says. Raises InputError, one
    line that names the file, if it is missing, damaged, too large, or lacks an array.
    """
    path = Path(path)
    try:
        if not zipfile.is_zipfile(check_file(path)):
            raise InputError(f"{path}: not {kind}, or damaged (no .npz file, or its end is missing)")
        with zipfile.ZipFile(path) as archive:
            ARRAYS.check("it holds", len(archive.infolist()))
            members = {part.filename.removesuffix(".npy"): part for part in archive.infolist()}
            if len(members) < len(archive.infolist()):
                raise InputError("it holds two arrays of one name")
            UNPACKED_BYTES.check("it holds", sum(part.file_size for part in members.values()))
            missing = [name for name in names if name not in members]
            arrays = {}
            for name in [] if missing else names or list(members):
                part = members[name]
                with archive.open(part) as file:
                    arrays[name] = _parse(file, part.file_size, part.filename)
                    file.read(1)  # at the end the checksum is compared
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
        return _parse(io.BytesIO(content), len(content), "it")
    except Exception as error:  # numpy raises whatever the damage makes it raise
        raise InputError(f"{path}: no .npy file, or damaged ({' '.join(str(error).split())[:100]})") from None


def _parse(file: IO[bytes], file_size: int, name: str) -> np.ndarray:
    """Read an array, whose header has to promise just the bytes that are there."""
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise InputError(f"{name}: a format of arrays that is not read")
    shape, by_columns, kind = _HEADERS[version](file)
    if kind.kind not in _KINDS:
        raise InputError(f"{name}: an array of {kind}, expected numbers or texts")
    size, there = kind.itemsize, file_size - file.tell()
    for length in shape:
        size *= length
    if min(shape, default=0) < 0 or size != there:
        raise InputError(f"{name}: its header says {quote(size)} bytes, it has {there:,}")
    flat = np.empty(size, np.uint8)
    if size and file.readinto(flat.data) != size:  # type: ignore[attr-defined]
        raise InputError(f"{name}: cut off")
    array = flat.view(kind) if size else np.empty(0, kind)
    return array.reshape(shape, order="F" if by_columns else "C")
