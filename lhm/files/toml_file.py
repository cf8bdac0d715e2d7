"""Options from a TOML file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import InputError, MissingDependencyError


def read_toml(path: Path) -> dict[str, Any]:
    """What a TOML file names; InputError, one line, for one that is missing or no TOML."""
    try:
        import tomllib
    except ModuleNotFoundError:
        raise MissingDependencyError(f"{path}: TOML files are read from Python 3.11 on") from None
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a TOML file that can be read ({' '.join(str(error).split())[:80]})") from None
