"""Messages between page, server and refining process: changes in, frames and notes out.

A change is JSON: its number, the weights that are not 0, and the parameters that differ from where the page began.
A frame is binary: the length of a JSON header (uint32), the header, and little-endian float32 of n vertices: positions
[mm] (n, 3), distance to blendshapes [mm] (n,), estimated error [mm] (n,). Notes are JSON. Float32 resolves 8e-6 mm at
the size of a head.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ...lhm.base.checks import number
from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.text import parse_json
from ...lhm.base.limits import CHANGE_BYTES
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.identities.arkit import ARKIT
from ...reference import Parameters
from .controls import BY_NAME, check_within

LARGEST_NUMBER = 2**53
"""Largest number of a change: JavaScript counts no further."""
_COLUMNS = {name: k for k, name in enumerate(ARKIT)}


@dataclass(frozen=True, eq=False)
class Change:
    """A page's wish: its number of the change, weights (52,) and p."""

    number: int
    weights: Floats32
    parameters: Parameters


@dataclass(frozen=True, eq=False)
class Frame:
    """An answer to a change: skin [mm] (n, 3), and how far the simulator is estimated to be.

    method: a label of `surrogate.methods`. error [mm], shape (n,): of each vertex; mean_error [mm]: over those that
    physics moves. Both are None where nothing is known. An estimate that is not `certain` may be off by a factor of
    three. `is_last` says that nothing better will come; `seconds` is the time since the work on the change began.
    crossings: pairs of triangles that cross in the simulator's skin, see `Face.count_crossings`; 0 where nobody looked.
    """

    change: int
    method: str
    skin: Floats32
    error: Floats32 | None
    mean_error: float | None
    certain: bool
    is_last: bool
    seconds: float
    crossings: int = 0


@dataclass(frozen=True, eq=False)
class DerivativesFound:
    """Offset (n, 3) and responses (52, n, 3) [mm] of T - S under p: from now on they answer at once."""

    parameters: Parameters
    offset: Floats32
    responses: Floats32


@dataclass(frozen=True)
class Note:
    """A line about a change: what is being done for it, or why that failed or was refused."""

    kind: Literal["doing", "failed", "refused"]
    text: str
    change: int | None = None

    def to_json(self) -> str:
        """Return it as the page reads it."""
        return json.dumps({"kind": self.kind, "text": self.text, "change": self.change})


def read_change(message: str | bytes, start: Parameters) -> Change:
    """Read a change of a page that began at `start`; InputError, one line, for anything else than one in range."""
    if not isinstance(message, str):
        raise InputError("change: expected JSON as text, got bytes")
    CHANGE_BYTES.check("change", len(message))
    said = parse_json(message)
    if not isinstance(said, dict) or said.keys() != {"change", "weights", "parameters"}:
        raise InputError("change: expected an object of 'change', 'weights' and 'parameters'")
    number = said["change"]
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < LARGEST_NUMBER:
        raise InputError(f"change: expected a number from 0 to 2^53, got {quote(number)}")
    weights = np.zeros(len(ARKIT), dtype=np.float32)
    for name, value in _numbers("weights", said["weights"], _COLUMNS).items():
        if not 0.0 <= value <= 1.0:
            raise InputError(f"weight {name} = {value:g} is outside [0, 1]")
        weights[_COLUMNS[name]] = value
    parameters = _numbers("parameters", said["parameters"], BY_NAME)
    for name, value in parameters.items():
        check_within(BY_NAME[name], value)
    return Change(number, weights, replace(start, **parameters))


def _numbers(name: str, said: Any, known: Mapping[str, object]) -> dict[str, float]:
    """Return an object of numbers by known names."""
    if not isinstance(said, dict):
        raise InputError(f"{name}: expected an object of numbers by name, got {quote(said)}")
    for key in said:
        if key not in known:
            raise InputError(f"{name}: {quote(key)!r} has no slider")
    return {key: number(f"{name}: {key}", value) for key, value in said.items()}


def pack_frame(frame: Frame, blended: Floats) -> bytes:
    """Pack a frame for the page; blended [mm], shape (n, 3), are the blendshapes that its distances are measured to."""
    distance = np.linalg.norm(frame.skin - blended, axis=1)
    error = np.zeros(len(distance)) if frame.error is None else frame.error
    header = {
        "change": frame.change,
        "vertices": len(frame.skin),
        "method": frame.method,
        "mean": frame.mean_error,
        "certain": frame.certain,
        "last": frame.is_last,
        "seconds": frame.seconds,
        "crossings": frame.crossings,
    }
    text = json.dumps(header, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    arrays = (np.ascontiguousarray(array, dtype="<f4").tobytes() for array in (frame.skin, distance, error))
    return struct.pack("<I", len(text)) + text + b"".join(arrays)
