"""Which expressions the scans of a person show, by guess, as JSON or CSV; the scans lie beside that file.

{"smile.obj": {"mouthSmileLeft": 1, "mouthSmileRight": 1}, "open.ply": {"jawOpen": 0.8}}

scan,jawOpen,mouthSmileLeft,mouthSmileRight          what is not named, or empty, is 0
smile.obj,,1,1
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..base.errors import InputError
from ..base.files.text import is_plain_file, parse_json, read_bytes
from ..base.limits import JSON_BYTES
from ..base.mesh import Floats
from ..expressions.blending import weights_of


def read_guesses(path: str | os.PathLike[str]) -> dict[Path, Floats]:
    """Weights (52,) by scan, in the file's order; InputError names the file, the scan and the expression."""
    path = Path(path)
    if path.suffix.lower() not in (".json", ".csv"):
        raise InputError(f"{path}: unknown kind of file; expected .json or .csv")
    content = read_bytes(path, JSON_BYTES)
    try:
        rows = _of_json(content) if path.suffix.lower() == ".json" else _of_csv(content)
        found = _weights(rows, path.parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return found


def _weights(rows: Iterable[tuple[str, Mapping[str, Any]]], folder: Path) -> dict[Path, Floats]:
    found: dict[Path, Floats] = {}
    for name, named in rows:
        scan = folder / name
        if scan in found:
            raise InputError(f"{name}: it stands there twice")
        try:
            found[scan] = weights_of(named)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        if not is_plain_file(scan):
            raise InputError(f"{name}: no such file beside it")
    if not any(weights.any() for weights in found.values()):
        raise InputError("no scan shows an expression; expected weights as {'smile.obj': {'mouthSmileLeft': 1}}")
    return found


def _of_json(content: bytes) -> list[tuple[str, Mapping[str, Any]]]:
    rows = parse_json(content)
    if not isinstance(rows, dict):
        raise InputError('expected weights by scan, {"smile.obj": {"mouthSmileLeft": 1}, ...}')
    return list(rows.items())


def _of_csv(content: bytes) -> list[tuple[str, Mapping[str, Any]]]:
    try:
        text = content.decode("utf-8-sig")
        head, *rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text)) if any(row)]
    except UnicodeDecodeError:
        raise InputError("it is no text") from None
    except (csv.Error, ValueError):
        raise InputError("no lines of scan and weights in it") from None
    if head[0].lower() != "scan":
        raise InputError(f"line 1: begins with {head[0][:40]!r}, expected: scan,jawOpen,...")
    found: list[tuple[str, Mapping[str, Any]]] = []
    for row in rows:
        if len(row) != len(head):
            raise InputError(f"{row[0]}: {len(row) - 1} weights, the first line names {len(head) - 1}")
        found.append((row[0], {name: _number(cell) for name, cell in zip(head[1:], row[1:], strict=True) if cell}))
    return found


def _number(cell: str) -> Any:
    try:
        return float(cell)
    except ValueError:
        return cell
