"""Bytes, JSON and TOML from files, within bounds."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, MeshError, MissingDependencyError, escape, quote
from ..limits import FILE_BYTES, JSON_BYTES, JSON_DEPTH, JSON_DIGITS, TOML_BYTES, Bound


def is_plain_file(path: Path) -> bool:
    """Return whether there is a file of that name, no folder or device; False for what can be no name."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or with a NUL
        return False


def check_file(path: str | os.PathLike[str], bound: Bound = FILE_BYTES) -> Path:
    """Return the path of a plain file; InputError names one that is missing, no plain file, or beyond the bound."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file" if not path.exists() else f"{path}: not a plain file")
    bound.check(str(path), path.stat().st_size)
    return path


def check_folder(path: str | os.PathLike[str]) -> Path:
    """Return the path of a folder; InputError if there is none of that name."""
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder")
    return path


@contextmanager
def naming_file(path: str | os.PathLike[str]) -> Iterator[None]:
    """Make every error of input or mesh an InputError that names the file, once."""
    try:
        yield
    except (InputError, MeshError) as error:
        said = str(error)
        raise InputError(said if str(path) in said else f"{path}: {said}") from None


def read_bytes(path: str | os.PathLike[str], bound: Bound = FILE_BYTES) -> bytes:
    """Return a file's content; InputError if it is missing, no plain file, unreadable, or larger than the bound."""
    try:
        with check_file(path, bound).open("rb") as file:
            content = file.read(bound.most + 1)  # it may have grown
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    bound.check(str(path), len(content))
    return content


def read_json(path: str | os.PathLike[str], of: str = "a JSON file", *, allow_nan: bool = False) -> Any:
    """Return what a JSON file says; `of` is what the file should be. InputError, one line, names the file."""
    try:
        return parse_json(read_bytes(path, JSON_BYTES), allow_nan=allow_nan)
    except InputError as error:
        said = str(error)
        raise InputError(said if said.startswith(str(path)) else f"{path}: not {of} ({said})") from None


def parse_json(content: bytes | str, *, allow_nan: bool = False) -> Any:
    """Return what a JSON text (UTF-8) says; InputError for bad JSON, deep nesting, huge integers, or NaN.

    NaN and Infinity, which JSON has not, are let pass for readers that name their place: `allow_nan`.
    """

    def integer(digits: str) -> int:
        JSON_DIGITS.check("JSON", len(digits.lstrip("-")))
        return int(digits)

    def real(word: str) -> float:
        value = float(word)
        if not allow_nan and not np.isfinite(value):
            raise InputError(f"{quote(word)} is no finite number")
        return value

    try:
        said = content.decode("utf-8-sig") if isinstance(content, bytes) else content.removeprefix("\ufeff")
        JSON_BYTES.check("JSON", len(said))
        JSON_DEPTH.check("JSON", _depth(said))
        return json.loads(said, parse_int=integer, parse_constant=real, parse_float=real)
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text, at byte {error.start}") from None
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {escape(' '.join(str(error).split()))[:80]}") from None


STRING = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)


def _depth(said: str) -> int:
    """Return how deep brackets are nested, without those inside strings."""
    opened = said.count("[") + said.count("{")
    if opened <= JSON_DEPTH.most:
        return opened
    code = np.frombuffer(STRING.sub("", said).encode("utf-8", "replace"), np.uint8)
    step = np.isin(code, (ord("["), ord("{"))).astype(np.int32) - np.isin(code, (ord("]"), ord("}")))
    return int(np.cumsum(step).max(initial=0))


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
