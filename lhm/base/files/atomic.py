"""Files that are whole or not there: written beside their place, then moved."""

from __future__ import annotations

import errno
import os
import secrets
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import InputError, quote

_unfinished: set[Path] = set()


@contextmanager
def replaced(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder (made if missing) that takes the place of `path` on success.

    On any error the temporary file is removed and `path` stays as it was. Raises InputError naming `path` where it
    cannot be written, and where something is there that `check_replaceable` refuses.
    """
    path = Path(path)
    check_replaceable(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Named before it is made, so that an interruption at any place finds it here.
        # Names end at 255 characters.
        temporary = path.parent / f".{path.stem[:100]}-{secrets.token_hex(4)}{path.suffix}"
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


KINDS = {
    stat.S_IFDIR: "Is a directory",
    stat.S_IFIFO: "it is a pipe",
    stat.S_IFSOCK: "it is a socket",
    stat.S_IFCHR: "it is a device",
    stat.S_IFBLK: "it is a device",
}
"""What is no plain file, by its format in `st_mode`."""


def check_replaceable(path: str | os.PathLike[str]) -> None:
    """Raise InputError for a path at which there is anything but a plain file that may be written, or nothing.

    A link is refused with the name of where it leads: to replace it would leave that as it was. A file without any
    permission to write is refused, also for root, who may write it all the same.
    """
    try:
        mode = os.lstat(path).st_mode
        if stat.S_ISLNK(mode):
            reason = f"it is a link to {quote(os.readlink(path), 200)}; give that name"
        elif not stat.S_ISREG(mode):
            reason = KINDS.get(stat.S_IFMT(mode), "it is no plain file")
        elif not mode & 0o222 or not os.access(path, os.W_OK):
            reason = "it is read-only"
        else:
            return
    except OSError as error:
        if error.errno == errno.ENOENT:
            return
        reason = error.strerror or str(error)
    raise InputError(f"{path}: cannot be written ({reason})")


def remove_unfinished() -> None:
    """Remove the temporary files of this process: for an end at once, which no `finally` sees."""
    for temporary in list(_unfinished):
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_place(path: str | os.PathLike[str], *, folder: bool) -> None:
    """Raise InputError for a path at which no file or `folder` can be: below a file, or where writing is forbidden.

    For work of minutes to fail before it begins; a disk that is full by then is another matter.
    """
    if not folder:
        check_replaceable(path)
    there = Path(path).absolute() if folder else Path(path).absolute().parent
    try:
        while not (there.exists() or there.is_symlink()):  # an OSError for a name that is too long
            there = there.parent
        if not there.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        with tempfile.TemporaryFile(dir=there):
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
