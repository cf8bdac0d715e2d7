"""results.json of a study, checked before a comparison or a report uses it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError, escape, quote
from ...lhm.base.files.text import parse_json, read_bytes
from ...lhm.base.limits import RESULT_BYTES

STATUSES = ("done", "skipped", "failed")
_KINDS: dict[str, tuple[type, ...]] = {
    "case": (str,),
    "method": (str,),
    "status": (str,),
    "values": (dict,),
    "reason": (str,),
    "seconds": (int, float),
    "memory_mb": (int, float, type(None)),
    "load": (int, float),
    "of": (str,),
    "commit": (str,),
}
"""Of a row's fields; the first four are in every row."""
_GATE: dict[str, tuple[type, ...]] = {
    "what": (str,),
    "passed": (bool,),
    "value": (int, float, type(None)),
    "bound": (str,),
    "answer": (bool,),
}
"""Of a gate's fields; the first two are in every gate."""


def read_results(path: Path) -> dict[str, Any]:
    """Return what a results file says, or the folder with one: study, rows and gates of the right kinds.

    Raises InputError that names the file, and the row or gate.
    """
    file = path / "results.json" if path.is_dir() else path
    try:
        said = parse_json(read_bytes(file, RESULT_BYTES))
        if not isinstance(said, dict) or not isinstance(said.get("study"), str):
            raise InputError("expected an object with the name of its study")
        _check_list("row", said.get("rows"), _KINDS, 4)
        _check_list("gate", said.setdefault("gates", []), _GATE, 2)
        for number, row in enumerate(said["rows"]):
            if row["status"] not in STATUSES:
                raise InputError(f"row {number}, status: {quote(row['status'])}, expected one of {', '.join(STATUSES)}")
    except InputError as error:
        raise InputError(f"{file}: no results of a study ({error})") from None
    return said


@contextmanager
def of_this_version(where: str) -> Iterator[None]:
    """Turn what a study's own code raises of values that are not its own into an InputError that names `where`."""
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError) as error:
        reason = escape(" ".join(str(error).split()))[:80]
        raise InputError(
            f"{where}: results damaged, or made by another version ({type(error).__name__}: {reason}); "
            "run that study again"
        ) from None


def _check_list(name: str, items: Any, kinds: dict[str, tuple[type, ...]], needed: int) -> None:
    if not isinstance(items, list):
        raise InputError(f"{name}s: expected a list, got {quote(items)}")
    for number, item in enumerate(items):
        if not isinstance(item, dict):
            raise InputError(f"{name} {number}: expected an object, got {quote(item)}")
        for place, (key, of) in enumerate(kinds.items()):
            if key not in item and place < needed:
                raise InputError(f"{name} {number}: no {key}")
            if key in item and (not isinstance(item[key], of) or (isinstance(item[key], bool) and bool not in of)):
                raise InputError(f"{name} {number}, {key}: got {quote(item[key])}")
