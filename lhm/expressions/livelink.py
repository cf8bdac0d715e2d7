"""LiveLink Face's CSV: one line per frame, `Timecode`, `BlendShapeCount`, 52 weights and nine angles.

Columns are found by name, whatever their order and case (JawRight stands before JawLeft). A timecode is
HH:MM:SS:FF.fff: frames FF.fff since the second, at a rate that the file does not say. It is read as the least usual one
above the largest FF; in a take without a whole second, whose FF say little, as 60.

HeadYaw, HeadPitch and HeadRoll are read as radians; a head whose angles are all zero was not tracked. In real takes the
eyes' yaw falls with eyeLookOutLeft and their pitch with eyeLookUp: yaw turns to the subject's right, pitch downward.
The head's are taken alike, and roll, of which no weight tells, as the same mirrored frame has it.

Where the phone loses the face it writes BlendShapeCount 0, by itself or with values that say nothing. Such lines are
left out and counted; the frames around keep their times, so that a gap stands where they were.
"""

from __future__ import annotations

import csv
import difflib
import io
import re

import numpy as np

from ..arkit import ARKIT
from ..base.errors import InputError, quote
from ..base.mesh import Floats
from .take import Take, take_of

TIMECODE_RATES = (24, 25, 30, 48, 50, 60, 100, 120, 240)
USUAL_RATE = 60
ANGLES = ("Yaw", "Pitch", "Roll")
BESIDE = {
    "timecode",
    "blendshapecount",
    *(f"{of}{a}".lower() for of in ("Head", "LeftEye", "RightEye") for a in ANGLES),
}
MIRRORED = (-1.0, 1.0, -1.0)
_TIMECODE = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})[:;](\d{1,3}(?:\.\d+)?)")
_DAY = 24 * 3600


def parse_csv(text: str) -> Take:
    """The take in a CSV's text; InputError names line and column.

    Other columns are ignored, unless the name is nearly one of the 52 that the file lacks.
    """
    try:
        rows = [(number, row) for number, row in enumerate(csv.reader(io.StringIO(text)), start=1) if any(row)]
    except csv.Error as error:
        raise InputError(f"not a take ({error})") from None
    header = [name.strip() for name in rows[0][1]] if rows else []
    columns = _columns(header)
    place = {name.lower(): number for number, name in enumerate(header)}
    if "timecode" not in place:
        raise InputError("line 1: no column Timecode, so its times are not known")
    frames = [(line, row) for line, row in rows[1:] if not _without_face(row, place)]
    for line, row in frames:
        if len(row) != len(header):
            raise InputError(f"line {line}: {len(row)} columns, line 1 has {len(header)}")
    if not frames:
        raise InputError("no frames with a face" if rows[1:] else "no frames, only the line of names")
    rate, times = _times([line for line, _ in rows[1:]], [row[place["timecode"]] for _, row in rows[1:]])
    found = np.array([not _without_face(row, place) for _, row in rows[1:]])
    return take_of(
        _values(frames, header, list(columns)),
        list(columns.values()),
        rate,
        times[found] - times[found][0],
        head=_head(frames, header, place),
        lost_at=times[~found] - times[found][0],
    )


def _without_face(row: list[str], place: dict[str, int]) -> bool:
    """Whether a line says that there is no face: `timecode,0`, or 0 in the column BlendShapeCount."""
    counted = place.get("blendshapecount")
    return counted is not None and counted < len(row) and row[counted].strip() == "0"


def _head(frames: list[tuple[int, list[str]]], header: list[str], place: dict[str, int]) -> Floats | None:
    """The head's angles (see `head_rotation`), or None where there are none."""
    columns = [place.get(f"head{angle}".lower()) for angle in ANGLES]
    if None in columns:
        return None
    angles = _values(frames, header, columns)  # type: ignore[arg-type]
    return np.unwrap(angles, axis=0) * MIRRORED if angles.any() else None


def _columns(header: list[str]) -> dict[int, str]:
    """Which columns hold which of the 52."""
    known = {name.lower(): name for name in ARKIT}
    columns = {number: known[name.lower()] for number, name in enumerate(header) if name.lower() in known}
    found = list(columns.values())
    if not found:
        raise InputError("not a take: line 1 names none of ARKit's 52 expressions")
    twice = [name for name in ARKIT if found.count(name) > 1]
    if twice:
        raise InputError(f"line 1: column {twice[0]} stands there {found.count(twice[0])} times")
    lacking = {name.lower(): name for name in ARKIT if name not in found}
    for name in header:
        if name.lower() in known or name.lower() in BESIDE:
            continue
        near = difflib.get_close_matches(name.lower(), lacking, n=1, cutoff=0.85)
        if near:
            raise InputError(f"line 1: unknown column {quote(name)!r}; did you mean {lacking[near[0]]}?")
    return columns


def _values(frames: list[tuple[int, list[str]]], header: list[str], columns: list[int]) -> Floats:
    values = np.empty((len(frames), len(columns)))
    for frame, (line, row) in enumerate(frames):
        for place, column in enumerate(columns):
            try:
                values[frame, place] = float(row[column])
            except ValueError:
                raise InputError(f"line {line}, column {header[column]}: {quote(row[column])!r} is no number") from None
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        frame, place = bad[0]
        line, row = frames[frame]
        raise InputError(f"line {line}, column {header[columns[place]]}: {quote(row[columns[place]])} is not finite")
    return values


def _times(lines: list[int], timecodes: list[str]) -> tuple[float, Floats]:
    """The frames' rate [Hz] and times [s], the first at 0."""
    parts = np.empty((len(timecodes), 4))
    for number, (line, timecode) in enumerate(zip(lines, timecodes, strict=True)):
        match = _TIMECODE.fullmatch(timecode.strip())
        if match is None:
            raise InputError(f"line {line}, column Timecode: {quote(timecode)!r}, expected HH:MM:SS:FF.fff")
        parts[number] = [float(part) for part in match.groups()]
    seconds = parts[:, :3] @ [3600, 60, 1]
    seconds = seconds + _DAY * np.concatenate([[0], np.cumsum(np.diff(seconds) < -_DAY / 2)])
    largest = int(parts[:, 3].max())
    usual = [rate for rate in TIMECODE_RATES if rate > largest and (rate >= USUAL_RATE or np.ptp(seconds) > 1)]
    if not usual:
        line = lines[int(parts[:, 3].argmax())]
        raise InputError(f"line {line}, column Timecode: frame {largest}, expected below {TIMECODE_RATES[-1]}")
    at = seconds * usual[0] + parts[:, 3]
    steps = np.diff(at)
    if (steps <= 0).any():
        raise InputError(f"line {lines[int(np.argmax(steps <= 0)) + 1]}, column Timecode: time does not rise")
    step = round(float(np.median(steps)), 2) if len(steps) else 1.0
    return usual[0] / max(step, 0.01), (at - at[0]) / usual[0]
