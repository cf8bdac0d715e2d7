"""Work of hours in a folder, which goes on where it was stopped: a file that says what it is of, and what is done.

Simulated takes and studies keep a line of JSON per piece here, takes and corpora what they are of. A piece that is
arrays is a file of its own, whole or not there (`atomic`): a take's frame, and a corpus' person, whose shard has a
checksum and its corpus' name as well, since it is copied and read without its folder. `lock_folder` keeps a second run
out.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import InputError
from .atomic import write_whole
from .text import read_json


class Records:
    """Lines of JSON, added as pieces of work are done; one that a kill has torn is as if it were not there."""

    def __init__(self, path: Path):
        self.path = path

    def read(self) -> list[dict[str, Any]]:
        """All whole records in the order in which they were added; none where there is no file."""
        try:
            lines = self.path.read_bytes().splitlines()
        except OSError:
            return []
        return [record for line in lines if (record := _record(line)) is not None]

    def add(self, record: Mapping[str, Any]) -> None:
        """Append one, without NaN; InputError if it cannot be written."""
        line = json.dumps(record, allow_nan=False).encode() + b"\n"
        try:
            with self.path.open("a+b") as file:
                file.seek(max(0, file.tell() - 1))
                torn = file.read() not in (b"", b"\n")
                file.write(b"\n" + line if torn else line)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror})") from None

    def keep(self, records: Iterable[Mapping[str, Any]]) -> None:
        """Have these and no others."""
        write_whole(self.path, b"".join(json.dumps(each, allow_nan=False).encode() + b"\n" for each in records))


def _record(line: bytes) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def read_manifest(path: Path, what: str, names: Iterable[str] = ()) -> dict[str, Any] | None:
    """What a folder's file says that its work is of, `what` in words, with all these names; None if there is none.

    Raises InputError for a file that says something else.
    """
    if not path.exists():
        return None
    try:
        found = read_json(path)
    except InputError:
        found = None
    if not isinstance(found, dict) or not set(names) <= set(found):
        raise InputError(f"{path}: damaged, or of no {what} of softdeca; use another folder")
    return found


def check_manifest(path: Path, what: str, manifest: Mapping[str, Any]) -> bool:
    """Whether the folder's work has begun; InputError, naming what differs, if it is not of this manifest."""
    found = read_manifest(path, what)
    for name, value in manifest.items():
        if found is not None and found.get(name) != value:
            raise InputError(
                f"{path.parent}: holds a {what} of another {name} ({found.get(name)}, expected {value}); "
                "use another folder or remove it"
            )
    return found is not None


def begin_work(path: Path, what: str, manifest: Mapping[str, Any]) -> None:
    """Note what a folder's work is of, where it has not begun; raises what `check_manifest` raises."""
    if not check_manifest(path, what, manifest):
        write_whole(path, json.dumps(dict(manifest), indent=1).encode())


@contextmanager
def lock_folder(folder: Path, what: str) -> Iterator[None]:
    """Make the folder and hold it against a second `what`; InputError if one runs there or it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / ".lock", "w")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder}: another {what} runs there; wait for it or give another --out") from None
        yield
