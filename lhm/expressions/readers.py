"""Takes read from LiveLink Face's CSV, a recorder's weights.csv, or JSON."""

from __future__ import annotations

import csv
import difflib
import io
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..arkit import ARKIT, index
from ..base.checks import check_arguments
from ..base.errors import InputError, quote
from ..base.files.text import parse_json as from_json
from ..base.files.text import read_bytes
from ..base.limits import TAKE_BYTES, TAKE_FRAMES
from ..base.mesh import Floats
from .takes import Take, angles_from_rotations, check_rate, rotations_from_quaternions, take_of


@check_arguments
def read_take(path: str | os.PathLike[str]) -> Take:
    """A take from a CSV of LiveLink Face (`livelink`) or of a row per quantity (`weights_csv`), or JSON (`take_json`).

    By its suffix, and a CSV by what it holds. Values outside [0, 1] are clipped and counted, frames without a face left
    out and counted, expressions that the file lacks are zero and named: all stand in the Take. Raises InputError, one
    line that names the file and, where there are such, line or frame and column.
    """
    parsers = {".csv": parse_csv, ".json": parse_json}
    path = Path(path)
    parse = parsers.get(path.suffix.lower())
    if parse is None:
        raise InputError(f"{path}: unknown kind of file; expected one of {', '.join(parsers)}")
    content = read_bytes(path, TAKE_BYTES)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: cannot be read (it is no text)") from None
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    if parse is parse_csv and is_transposed(text):
        parse = parse_transposed
    try:
        return parse(text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


# DOC """LiveLink Face's CSV: one line per frame, `Timecode`, `BlendShapeCount`, 52 weights and nine angles.
# DOC
# DOC Columns are found by name, whatever their order and case (JawRight stands before JawLeft). A timecode is
# DOC HH:MM:SS:FF.fff: frames FF.fff since the second, at a rate that the file does not say. It is read as the least usual one
# DOC above the largest FF; in a take without a whole second, whose FF say little, as 60.
# DOC
# DOC HeadYaw, HeadPitch and HeadRoll are read as radians; a head whose angles are all zero was not tracked. In real takes the
# DOC eyes' yaw falls with eyeLookOutLeft and their pitch with eyeLookUp: yaw turns to the subject's right, pitch downward.
# DOC The head's are taken alike, and roll, of which no weight tells, as the same mirrored frame has it.
# DOC
# DOC Where the phone loses the face it writes BlendShapeCount 0, by itself or with values that say nothing. Such lines are
# DOC left out and counted; the frames around keep their times, so that a gap stands where they were.
# DOC """
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
    rate, times = _times_from_timecodes([line for line, _ in rows[1:]], [row[place["timecode"]] for _, row in rows[1:]])
    found = np.array([not _without_face(row, place) for _, row in rows[1:]])
    return take_of(
        _values(frames, header, list(columns)),
        list(columns.values()),
        rate,
        times[found] - times[found][0],
        head=_head_angles(frames, header, place),
        lost_at=times[~found] - times[found][0],
    )


def _without_face(row: list[str], place: dict[str, int]) -> bool:
    """Whether a line says that there is no face: `timecode,0`, or 0 in the column BlendShapeCount."""
    counted = place.get("blendshapecount")
    return counted is not None and counted < len(row) and row[counted].strip() == "0"


def _head_angles(frames: list[tuple[int, list[str]]], header: list[str], place: dict[str, int]) -> Floats | None:
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


def _times_from_timecodes(lines: list[int], timecodes: list[str]) -> tuple[float, Floats]:
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


# DOC """A recorder's weights.csv: a row per quantity, a column per frame, 60 Hz.
# DOC
# DOC As apps of this kind write it: a first row of frames' numbers (which may be longer than the rest), then rows that begin
# DOC with a name: `timestamp` [s], the 52 weights, and `head x`, `head y`, `head z`, `head w`, a quaternion of the head from
# DOC its pose in the first frame (ARKit's axes: x to the face's own left, y up, z forward, as ours). Rows stand in any order;
# DOC those of the eyes and others are ignored. Without timestamps the frames are 1/60 s apart.
# DOC """
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
    rate, times = _times_from_stamps(values.get(TIME), len(next(iter(values.values()))))
    return take_of(
        np.stack([values[name] for name in names], axis=1), names, rate, times, head=_head_from_quaternions(values)
    )


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


def _times_from_stamps(stamps: Floats | None, frames: int) -> tuple[float, Floats]:
    """The rate [Hz] and the frames' times [s], the first at 0."""
    if stamps is None:
        return RATE, np.arange(frames) / RATE
    steps = np.diff(stamps)
    if (steps <= 0).any():
        raise InputError(f"{TIME}, frame {int(np.argmax(steps <= 0)) + 1}: time does not rise")
    rate = 1.0 / float(np.median(steps)) if len(steps) else RATE
    return (RATE if abs(rate - RATE) < 1.0 else rate), stamps - stamps[0]


def _head_from_quaternions(values: dict[str, Floats]) -> Floats | None:
    if not all(name in values for name in HEAD):
        return None
    quaternions = np.stack([values[name] for name in HEAD], axis=1)
    none = np.flatnonzero(~quaternions.any(axis=1))
    if len(none):
        raise InputError(f"head, frame {none[0]}: a quaternion of zeros is no rotation")
    return angles_from_rotations(rotations_from_quaternions(quaternions))


# DOC """Takes as JSON: an object with `frames`, and `rate` (or `fps`) [Hz] unless the frames carry their times.
# DOC
# DOC     {"rate": 30, "frames": [{"jawOpen": 0.2, "mouthFunnel": 0.1}, {}, ...]}     what is not named is 0
# DOC     {"rate": 30, "names": ["jawOpen", ...], "frames": [[0.2, ...], ...]}        one value per name
# DOC     {"names": ["jawOpen", ...], "frames": [{"weights": [0.2, ...], "time": 0.0}, ...]}     times [s], as BEAT has them
# DOC
# DOC Names are ARKit's, whatever their order and case; an unknown one is an error. Of `rate` and `time` the times win.
# DOC """
_BY_LOWER = {name.lower(): name for name in ARKIT}


def parse_json(text: str) -> Take:
    """The take in a JSON text, of one of the forms above; InputError names frame and expression."""
    content = from_json(text, allow_nan=True)  # weights and times that are not finite are named with their frame
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError('not a take: expected an object with a list "frames" that is not empty')
    TAKE_FRAMES.check('"frames"', len(frames))
    timed = [frame.get("time") if isinstance(frame, dict) and "weights" in frame else None for frame in frames]
    if isinstance(frames[0], dict) and "weights" not in frames[0]:
        names, values = _of_objects(frames)
    else:
        names = _names(content.get("names"))
        values = _of_lists([f["weights"] if isinstance(f, dict) and "weights" in f else f for f in frames], names)
    rate, times = _uniform(content, len(frames)) if timed[0] is None else _timed(timed)
    return take_of(values, names, rate, times)


def _of_objects(frames: list[Any]) -> tuple[list[str], Floats]:
    values = np.zeros((len(frames), len(ARKIT)))
    used = set()
    for number, frame in enumerate(frames):
        if not isinstance(frame, dict):
            raise InputError(f"frame {number}: expected an object of names and weights, as in frame 0")
        for name, value in frame.items():
            known = _known(name, f"frame {number}")
            values[number, ARKIT.index(known)] = _number(value, f"frame {number}, {name}")
            used.add(known)
    names = [name for name in ARKIT if name in used]
    return names, values[:, [ARKIT.index(name) for name in names]]


def _of_lists(frames: list[Any], names: list[str]) -> Floats:
    for number, frame in enumerate(frames):
        if not isinstance(frame, list) or len(frame) != len(names):
            raise InputError(f"frame {number}: expected a list of {len(names)} weights, one for each of names")
    return np.array(
        [
            [_number(value, f"frame {number}, {name}") for value, name in zip(frame, names, strict=True)]
            for number, frame in enumerate(frames)
        ]
    )


def _names(listed: Any) -> list[str]:
    if not isinstance(listed, list) or not listed:
        raise InputError('"names": expected the list of the expressions that each frame lists')
    names = [_known(name, "names") for name in listed]
    twice = [name for name in ARKIT if names.count(name) > 1]
    if twice:
        raise InputError(f'"names": {twice[0]} stands there {names.count(twice[0])} times')
    return names


def _known(name: Any, where: str) -> str:
    known = _BY_LOWER.get(str(name).lower())
    if known is not None:
        return known
    try:
        return ARKIT[index(str(name))]
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _number(value: Any, where: str) -> float:
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{where}: {quote(value)} is no finite number")
    return number


def _uniform(content: dict[str, Any], frames: int) -> tuple[float, Floats]:
    rate = _number(content.get("rate", content.get("fps")), '"rate"')
    check_rate(rate)
    return rate, np.arange(frames) / rate


def _timed(times: list[Any]) -> tuple[float, Floats]:
    values = np.array([_number(value, f"frame {number}, time") for number, value in enumerate(times)])
    steps = np.diff(values)
    if not len(steps) or (steps <= 0).any():
        where = int(np.argmax(steps <= 0)) + 1 if len(steps) else 0
        raise InputError(f"frame {where}, time: expected two frames or more whose times rise")
    return 1.0 / float(np.median(steps)), values - values[0]
