"""Files that are whole or not there: written beside their place, then moved."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError


@contextmanager
def replaced(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder (made if missing) that takes the place of `path` on success.

    On any error the temporary file is removed and `path` stays as it was. Raises InputError naming `path` where it
    cannot be written, and where something is there that `check_replaceable` refuses.
    """
    path = Path(path)
    check_replaceable(path)
    # Names end at 255 characters.
    temporary = path.parent / f".{path.stem[:100]}-{secrets.token_hex(4)}{path.suffix}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.touch(exist_ok=False)
            if path.exists():  # a private file stays private
                temporary.chmod(path.stat().st_mode & 0o777)
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        raise InputError(f"{path}: cannot be written ({error.strerror or error}{where})") from None


def check_replaceable(path: str | os.PathLike[str]) -> None:
    """Raise InputError for a path at which there is anything but a plain file that may be written, or nothing."""
    path = Path(path)
    try:
        if not path.exists() or (path.is_file() and os.access(path, os.W_OK)):
            return
        reason = "it is read-only" if path.is_file() else "it is no plain file"
    except OSError as error:  # a name that is too long
        reason = error.strerror or str(error)
    raise InputError(f"{path}: cannot be written ({reason})")


def check_place(path: str | os.PathLike[str], *, folder: bool) -> None:
    """Raise InputError for a path at which no file or `folder` can be: below a file, or where writing is forbidden.

    For work of minutes to fail before it begins; a disk that is full by then is another matter.
    """
    if not folder:
        check_replaceable(path)
    there = Path(path).absolute() if folder else Path(path).absolute().parent
    try:
        while not there.exists():
            there = there.parent
        if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
            return
        reason = f"{there} is read-only" if there.is_dir() else f"{there} is no folder"
    except OSError as error:  # a name that is too long
        reason = error.strerror or str(error)
    raise InputError(f"{path}: cannot be written ({reason})")


def write_whole(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file that was made in memory; InputError if it cannot be written, and then it is as it was.

    The way for zip, HDF5 and the like: their libraries cannot end a file on a full disk without a noise or a crash.
    """
    with replaced(path) as temporary:
        temporary.write_bytes(content)


UNSEALED = "0" * 64
"""Stands for a file's checksum while that is computed."""


def seal(content: bytes) -> bytes:
    """Put the SHA-256 of a whole file in the place of UNSEALED, which it holds once."""
    return content.replace(UNSEALED.encode(), hashlib.sha256(content).hexdigest().encode(), 1)


def is_sealed(content: bytes, checksum: str) -> bool:
    """Whether `checksum`, which a file holds, is what `seal` gave it."""
    unsealed = content.replace(checksum.encode(), UNSEALED.encode(), 1)
    return len(checksum) == len(UNSEALED) and hashlib.sha256(unsealed).hexdigest() == checksum
