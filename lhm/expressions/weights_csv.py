"""A recorder's weights.csv: a row per quantity, a column per frame, 60 Hz.

As apps of this kind write it: a first row of frames' numbers (which may be longer than the rest), then rows that begin
with a name: `timestamp` [s], the 52 weights, and `head x`, `head y`, `head z`, `head w`, a quaternion of the head from
its pose in the first frame (ARKit's axes: x to the face's own left, y up, z forward, as ours). Rows stand in any order;
those of the eyes and others are ignored. Without timestamps the frames are 1/60 s apart.
"""

from __future__ import annotations

import csv
import difflib
import io

import numpy as np

from ..arkit import ARKIT
from ..base.errors import InputError, quote
from ..base.mesh import Floats
from .head_rotation import angles_of, of_quaternions
from .take import Take, take_of

RATE = 60.0
TIME, HEAD = "timestamp", ("head x", "head y", "head z", "head w")
_BY_LOWER = {name.lower(): name for name in ARKIT}


def is_transposed(text: str) -> bool:
    """Whether a CSV has the names of expressions down its first column rather than along its first line."""
    along, *rows = text.splitlines()
    first = {line.split(",", 1)[0].strip().strip('"').lower() for line in rows}
    return len(first & set(_BY_LOWER)) > sum(name.strip().strip('"').lower() in _BY_LOWER for name in along.split(","))


def parse_transposed(text: str) -> Take:
    """The take in a transposed CSV's text; InputError names line and quantity."""
    try:
        rows = [(number, row) for number, row in enumerate(csv.reader(io.StringIO(text)), start=1) if any(row)]
    except csv.Error as error:
        raise InputError(f"not a take ({error})") from None
    named = _named(rows)
    counts = {len(row) for _, row in named.values()}
    if len(counts) > 1:
        line, row = next(at for at in named.values() if len(at[1]) != max(counts))
        raise InputError(f"line {line}: {len(row) - 1} frames, other quantities have {max(counts) - 1}")
    if counts == {1}:
        raise InputError("no frames, only the names")
    values = {name: _numbers(name, *at) for name, at in named.items()}
    names = [name for name in ARKIT if name in values]
    rate, times = _times(values.get(TIME), len(next(iter(values.values()))))
    return take_of(np.stack([values[name] for name in names], axis=1), names, rate, times, head=_head(values))


def _named(rows: list[tuple[int, list[str]]]) -> dict[str, tuple[int, list[str]]]:
    """The lines that are read, by what they hold."""
    named: dict[str, tuple[int, list[str]]] = {}
    unknown = []
    for line, row in rows:
        name = row[0].strip().lower()
        known = _BY_LOWER.get(name, name)
        if known not in (*ARKIT, TIME, *HEAD):
            unknown.append((line, row[0].strip()))
        elif known in named:
            raise InputError(f"line {line}: {known} stands in line {named[known][0]} already")
        else:
            named[known] = line, row
    lacking = {name.lower(): name for name in ARKIT if name not in named}
    for line, name in unknown:
        near = difflib.get_close_matches(name.lower(), lacking, n=1, cutoff=0.85)
        if near:
            raise InputError(f"line {line}: unknown quantity {quote(name)!r}; did you mean {lacking[near[0]]}?")
    return named


def _numbers(name: str, line: int, row: list[str]) -> Floats:
    values = np.empty(len(row) - 1)
    for frame, text in enumerate(row[1:]):
        try:
            values[frame] = float(text)
        except ValueError:
            raise InputError(f"line {line}, {name}, frame {frame}: {quote(text)!r} is no number") from None
        if not np.isfinite(values[frame]):
            raise InputError(f"line {line}, {name}, frame {frame}: {quote(text)} is not finite")
    return values


def _times(stamps: Floats | None, frames: int) -> tuple[float, Floats]:
    """The rate [Hz] and the frames' times [s], the first at 0."""
    if stamps is None:
        return RATE, np.arange(frames) / RATE
    steps = np.diff(stamps)
    if (steps <= 0).any():
        raise InputError(f"{TIME}, frame {int(np.argmax(steps <= 0)) + 1}: time does not rise")
    rate = 1.0 / float(np.median(steps)) if len(steps) else RATE
    return (RATE if abs(rate - RATE) < 1.0 else rate), stamps - stamps[0]


def _head(values: dict[str, Floats]) -> Floats | None:
    if not all(name in values for name in HEAD):
        return None
    quaternions = np.stack([values[name] for name in HEAD], axis=1)
    none = np.flatnonzero(~quaternions.any(axis=1))
    if len(none):
        raise InputError(f"head, frame {none[0]}: a quaternion of zeros is no rotation")
    return angles_of(of_quaternions(quaternions))
