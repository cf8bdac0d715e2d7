"""Work of hours in a folder, which resumes: rows as lines of JSON, and a lock against a second run.

Studies keep such rows. A corpus has shards instead, each with a checksum and its corpus' name, since they are copied
and read without their folder, and a manifest that says what they are of.
"""

from __future__ import annotations

import errno
import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import InputError
from .atomic import check_replaceable
from .text import read_bytes

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""Numbers of the system's errors where a disk has no locks."""


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Read all whole rows of a file; a line that a kill has torn is left out. InputError for no plain file."""
    if not path.exists():
        return []
    rows = []
    for line in read_bytes(path).splitlines():
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(row, dict):
            rows.append(row)
    return rows


def add_row(path: Path, row: Mapping[str, Any]) -> None:
    """Append a row, without NaN; InputError if it cannot be written."""
    line = json.dumps(row, allow_nan=False).encode() + b"\n"
    check_replaceable(path)
    try:
        with path.open("a+b") as file:
            file.seek(max(0, file.tell() - 1))
            torn = file.read() not in (b"", b"\n")
            file.write(b"\n" + line if torn else line)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


@contextmanager
def lock_folder(folder: Path, what: str) -> Iterator[None]:
    """Make the folder and hold it against a second `what`; InputError if one runs there or it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        check_replaceable(folder / ".lock")
        lock = open(folder / ".lock", "a")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder}: another {what} runs there; wait for it or give another --out") from None
        except OSError as error:
            raise InputError(
                f"{folder}: cannot be locked ({error.strerror}), as on some network drives; use a local disk"
            ) from None
        yield
