"""Bytes, JSON and TOML from files, within bounds."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import FitError, InputError, MeshError, MissingDependencyError, escape, one_line, quote
from ..limits import FILE_BYTES, JSON_BYTES, TOML_BYTES, Bound


def is_plain_file(path: Path) -> bool:
    """Return whether there is a file of that name, no folder or device; False for what can be no name."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or with a NUL
        return False


def list_files(folder: Path, pattern: str = "*") -> list[Path]:
    """List a folder's plain files by name, without hidden ones, as macOS writes beside each for its attributes.

    `pattern` is of `Path.glob`.
    """
    return sorted(file for file in folder.glob(pattern) if not file.name.startswith(".") and is_plain_file(file))


def check_file(path: str | os.PathLike[str], bound: Bound = FILE_BYTES) -> Path:
    """Return the path of a plain file; InputError names one that is missing, no plain file, or beyond the bound."""
    path = Path(path)
    try:
        if not path.is_file():
            raise InputError(f"{path}: not a plain file" if path.exists() else f"{path}: no such file")
        size = path.stat().st_size
    except OSError as error:  # a name that is too long, or below a folder that is closed
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    bound.check(str(path), size)
    return path


def find_beside(path: Path, name: str) -> Path:
    """Return the plain file of a name that stands in the file `path`: in that one's own folder, or below it.

    Whoever wrote `path` must not choose among all files of the user. InputError for a name that is absolute, has a
    drive, a scheme or a part that begins with a dot, for a link that leads out of the folder, and for no plain file. A
    `path` that is a link is followed first.
    """
    parts = PurePosixPath(name).parts
    if re.search(r"[:\\]", name) or any(part.startswith(".") and part != ".." for part in parts):
        reason = "the name of a file in another has no ':', no '\\' and no part that begins with a dot"
        raise InputError(f"{quote(name, 80)}: {reason}")
    inside = not any(part in ("/", "//", "..") for part in parts)
    folder = path.resolve().parent
    place = folder / name if inside else folder
    if inside and not is_plain_file(place):
        raise InputError(f"{quote(name, 80)}: no such file beside it")
    if not inside or not place.resolve().is_relative_to(folder):
        raise InputError(f"{quote(name, 80)}: a file that is named in another has to lie in its folder")
    return place.resolve()


@contextmanager
def naming_file(path: str | os.PathLike[str]) -> Iterator[None]:
    """Raise errors of input, mesh or fit again as an InputError that names the file, once."""
    try:
        yield
    except (InputError, MeshError, FitError) as error:
        reason = str(error)
        raise InputError(reason if one_line(str(path)) in reason else f"{path}: {reason}") from None


def read_bytes(path: str | os.PathLike[str], bound: Bound = FILE_BYTES, *, first: int | None = None) -> bytes:
    """Return a file's content, or its `first` bytes.

    InputError if it is missing, no plain file, unreadable, or larger than the bound.
    """
    try:
        with check_file(path, bound).open("rb") as file:
            size = os.fstat(file.fileno()).st_size  # more is not asked for: room for it would be made first
            content = file.read(min(size, bound.most) + 1 if first is None else min(size, first))  # it may have grown
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    bound.check(str(path), len(content))
    return content


def read_json(path: str | os.PathLike[str], kind: str = "a JSON file") -> Any:
    """Return what a JSON file says; `kind` is what the file should be. InputError, one line, names the file."""
    try:
        return parse_json(read_bytes(path, JSON_BYTES))
    except InputError as error:
        reason = str(error)
        raise InputError(reason if reason.startswith(str(path)) else f"{path}: not {kind} ({reason})") from None


def parse_json(content: bytes | str, *, allow_nan: bool = False) -> Any:
    """Parse a JSON text (UTF-8); InputError for bad JSON, and for NaN and Infinity.

    `allow_nan` accepts these for readers that say where they stand.
    """

    def refuse(word: str) -> None:
        raise InputError(f"{word} is no finite number")

    try:
        text = content.decode("utf-8-sig") if isinstance(content, bytes) else content.removeprefix("\ufeff")
        JSON_BYTES.check("JSON", len(text))
        return json.loads(text, parse_constant=None if allow_nan else refuse)
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text, at byte {error.start}") from None
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {escape(' '.join(str(error).split()))[:80]}") from None


def parse_number(text: str) -> float:
    """Return the number that a text is; ValueError for none, also for what is one to Python alone, such as 1_0."""
    if "_" in text or not text.isascii():
        raise ValueError
    return float(text)


def read_toml(path: Path) -> dict[str, Any]:
    """Return what a TOML file names; InputError, one line, for a file that is missing, too large, or no TOML."""
    try:
        import tomllib
    except ModuleNotFoundError:
        raise MissingDependencyError(f"{path}: TOML files are read from Python 3.11 on") from None
    content = read_bytes(path, TOML_BYTES)
    try:
        return tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        reason = quote(" ".join(str(error).split()), 80)
        raise InputError(f"{path}: not a TOML file that can be read ({reason})") from None
