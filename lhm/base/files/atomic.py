"""Files that are whole or not there: written beside their place, then moved."""

from __future__ import annotations

import errno
import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import InputError

NAMED = 100
"""Characters of a file's name that its temporary one begins with: names end at 255."""
_unfinished: set[Path] = set()


@contextmanager
def replaced(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder (made if missing) that takes the place of `path` on success.

    On any error the temporary file is removed and `path` stays as it was. Raises InputError naming `path` where it
    cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Named before it is made, so that an interruption at any place finds it here.
        temporary = path.parent / f".{path.stem[:NAMED]}-{secrets.token_hex(4)}{path.suffix}"
        _unfinished.add(temporary)
        try:
            temporary.touch(0o600, exist_ok=False)
            yield temporary
            temporary.chmod(0o666 & ~_umask())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
            _unfinished.discard(temporary)
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        raise InputError(f"{path}: cannot be written ({error.strerror or error}{where})") from None


def remove_unfinished() -> None:
    """Remove the temporary files of this process: for an end at once, which no `finally` sees."""
    for temporary in list(_unfinished):
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_place(path: str | os.PathLike[str], *, folder: bool) -> None:
    """Raise InputError for a path at which no file or `folder` can be: below a file, or where writing is forbidden.

    For work of minutes to fail before it begins; a disk that is full by then is another matter.
    """
    there = Path(path).absolute()
    try:
        while not there.exists():  # an OSError for a name that is too long
            there = there.parent
        itself = there == Path(path).absolute()
        if not there.is_dir() and (folder or not itself):
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if there.is_dir() and itself and not folder:
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not os.access(there, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        with tempfile.TemporaryFile(dir=there if there.is_dir() else there.parent):
            pass  # folders such as /proc let root write by their mode, and hold no file of anybody's
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def write_whole(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file that was made in memory; InputError if it cannot be written, and then it is as it was.

    The way for zip, HDF5 and the like: their libraries cannot end a file on a full disk without a noise or a crash.
    """
    with replaced(path) as temporary:
        temporary.write_bytes(content)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
