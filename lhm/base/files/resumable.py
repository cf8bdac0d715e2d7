"""Work of hours in a folder, which resumes: a store of rows, and a lock against a second run.

A store has a line of JSON for each row; arrays lie beside them, a file each, whole or not there (`atomic`). Studies
keep such stores. A corpus has shards instead, each with a checksum and its corpus' name, since they are copied and read
without their folder, and a manifest that says what they are of.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .atomic import check_replaceable, write_whole
from .npz import read_arrays, write_arrays
from .text import read_bytes


class RowStore:
    """Rows of a folder's work, in the order in which they were added: JSON in `file`, arrays in files by name.

    Raises InputError where it cannot be written.
    """

    def __init__(self, folder: Path, *, file: str = "rows.jsonl"):
        self.folder, self.file = folder, folder / file

    def rows(self) -> list[dict[str, Any]]:
        """Return all whole rows; a line that a kill has torn is left out. InputError for no plain file."""
        if not self.file.exists():
            return []
        rows = []
        for line in read_bytes(self.file).splitlines():
            try:
                row = json.loads(line)
            except (ValueError, RecursionError):
                continue
            if isinstance(row, dict):
                rows.append(row)
        return rows

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row, without NaN; InputError if it cannot be written."""
        line = json.dumps(row, allow_nan=False).encode() + b"\n"
        check_replaceable(self.file)
        try:
            with self.file.open("a+b") as file:
                file.seek(max(0, file.tell() - 1))
                torn = file.read() not in (b"", b"\n")
                file.write(b"\n" + line if torn else line)
        except OSError as error:
            raise InputError(f"{self.file}: cannot be written ({error.strerror})") from None

    def keep(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Keep these rows and no others."""
        write_whole(self.file, b"".join(json.dumps(row, allow_nan=False).encode() + b"\n" for row in rows))

    def path(self, name: str) -> Path:
        """Return the file of the arrays of a name."""
        return self.folder / f"{name}.npz"

    def write(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Write arrays under a name, whole or not at all; InputError if they cannot be written."""
        write_arrays(self.path(name), arrays)

    def read(self, name: str, *wanted: str) -> dict[str, np.ndarray]:
        """Read the wanted arrays of a name, or all; InputError names a file that is missing or damaged."""
        return read_arrays(self.path(name), *wanted)

    def is_whole(self, name: str) -> bool:
        """Whether the arrays of a name are there and can be read."""
        try:
            self.read(name)
        except InputError:
            return False
        return True


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
        yield
