"""Options from a TOML file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..bounds import TOML_BYTES, plain
from ..errors import InputError, MissingDependencyError
from ..validate import read_bytes


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
        reason = plain(" ".join(str(error).split()))[:80]
        raise InputError(f"{path}: not a TOML file that can be read ({reason})") from None
