"""Takes from files: LiveLink Face's CSV, a recorder's weights.csv, JSON of MediaPipe, Audio2Face and BEAT.

`READERS` is the table of formats: a suffix, whether a text is of that format, and the function that reads it.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.checks import rotations_from_quaternions
from ..base.errors import InputError, quote
from ..base.files.text import parse_json as load_json
from ..base.files.text import parse_number, read_bytes
from ..base.limits import TAKE_BYTES, TAKE_FRAMES
from ..base.mesh import Floats
from ..identities.arkit import ARKIT, arkit_name, index
from .takes import RATES, Take, angles_from_rotations, check_rate, take_from_columns
from .timecodes import times_from_timecodes

Row = tuple[int, list[str]]
"""A line's number, from 1, and its cells."""


def read_take(path: str | os.PathLike[str]) -> Take:
    """Read a take from a CSV of LiveLink Face, a CSV with a row per quantity, or JSON of MediaPipe, Audio2Face or BEAT.

    `READERS` has them all. Names are found by `arkit_name`; a CSV may have semicolons or tabs, and decimal commas.

    Values outside [0, 1] are clipped and counted, frames without a face left out and counted, expressions that the file
    lacks are zero and named: all stand in the Take. Raises InputError, one line that names the file and, where there
    are such, line or frame and column.
    """
    path = Path(path)
    readers = [reader for reader in READERS if reader.suffix == path.suffix.lower()]
    if not readers:
        suffixes = ", ".join(dict.fromkeys(reader.suffix for reader in READERS))
        raise InputError(f"{path}: unknown kind of file; expected one of {suffixes}")
    text = _decode(path, read_bytes(path, TAKE_BYTES))
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    if path.suffix.lower() == ".csv":  # a line, or a column, per frame
        lines, comma = text.splitlines(), _delimiter(text)
        most = max((len(lines) - 1, *(line.count(comma) for line in lines)), default=1)
        TAKE_FRAMES.check(f"{path}: it has", max(most, 1))
    try:
        return next(reader for reader in readers if reader.fits(text)).read(text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _decode(path: Path, content: bytes) -> str:
    """Return a file's text, of UTF-8 or, as Windows' shell and Excel write it, UTF-16."""
    encoding = "utf-16-le" if content[1:2] == b"\0" else "utf-8-sig"
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        encoding = "utf-16"
    try:
        return content.decode(encoding)
    except UnicodeDecodeError:
        raise InputError(f"{path}: cannot be read (it is no text)") from None


# LiveLink Face's CSV: one line per frame, `Timecode`, `BlendShapeCount`, 52 weights and nine angles.

ANGLES = ("Yaw", "Pitch", "Roll")
OTHER_COLUMNS = {
    "timecode",
    "blendshapecount",
    *(f"{part}{angle}".lower() for part in ("Head", "LeftEye", "RightEye") for angle in ANGLES),
}
"""In small letters, without underscores."""
FULL_TURN = 6.3
"""[rad] Largest angle in a file: a little more than 2 pi."""
MIRRORED = (-1.0, 1.0, -1.0)
"""From the file's yaw, pitch and roll to ours. In real takes the eyes' yaw falls with eyeLookOutLeft and their pitch
with eyeLookUp: yaw turns to the subject's right, pitch downward. The head's are taken alike, and roll, of which no
weight tells, as the same mirrored frame has it."""


def read_livelink(text: str) -> Take:
    """Read a LiveLink CSV's text; InputError names line and column.

    Columns are found by name, whatever their order and case; others are ignored. Where the phone loses the face it
    writes BlendShapeCount 0, by itself or with values that say nothing: such lines are left out and counted, and a gap
    stands where they were. Head angles are radians; a head whose angles are all zero was not tracked.
    """
    rows = _rows(text)
    header = [name.strip() for name in rows[0][1]] if rows else []
    columns = _expression_columns(header)
    place = {name.lower().replace("_", ""): number for number, name in enumerate(header)}
    if "timecode" not in place:
        raise InputError("line 1: no column Timecode, so its times are not known")
    counted = place.get("blendshapecount")

    def has_count(line: int, row: list[str]) -> bool:
        cell = row[counted].strip() if counted is not None and counted < len(row) else ""
        return not cell or _number(cell, f"line {line}, column BlendShapeCount") != 0

    has_face = np.array([has_count(line, row) for line, row in rows[1:]], bool)
    frames = [row for row, kept in zip(rows[1:], has_face, strict=True) if kept]
    for line, row in frames:
        if len(row) != len(header):
            raise InputError(f"line {line}: {len(row)} columns, line 1 has {len(header)}")
    if not frames:
        raise InputError("no frames with a face" if rows[1:] else "no frames, only the line of names")
    rate, times = times_from_timecodes([(line, row[place["timecode"]]) for line, row in rows[1:]])
    start = times[has_face][0]

    def values(numbers: Sequence[int]) -> Floats:
        return np.array(
            [[_number(row[k], f"line {line}, column {header[k]}") for k in numbers] for line, row in frames]
        )

    weights = values(list(columns))
    _refuse_partial([f"Head{angle}" for angle in ANGLES], place)
    angles = [place[key] for key in (f"head{angle}".lower() for angle in ANGLES) if key in place]
    head = values(angles) if len(angles) == len(ANGLES) else np.zeros((1, 3))
    if np.abs(head).max() > FULL_TURN:
        frame, angle = np.argwhere(np.abs(head) > FULL_TURN)[0]
        raise InputError(
            f"line {frames[frame][0]}, column {header[angles[angle]]}: {head[frame, angle]:g} is more than a full "
            f"turn [rad]; is it in degrees?"
        )
    return take_from_columns(
        weights,
        list(columns.values()),
        rate,
        times[has_face] - start,
        head=np.unwrap(head, axis=0) * MIRRORED if head.any() else None,
        lost_at=times[~has_face] - start,
    )


def _expression_columns(header: list[str]) -> dict[int, str]:
    """Find the columns of the 52."""
    listed = [arkit_name(name) or name.lower().replace("_", "") for name in header]
    columns = {number: name for number, name in enumerate(listed) if name in ARKIT}
    if not columns:
        raise InputError("not a take: line 1 names none of ARKit's 52 expressions")
    twice = [name for name in (*ARKIT, *sorted(OTHER_COLUMNS)) if listed.count(name) > 1]
    if twice:
        raise InputError(f"line 1: column {twice[0]} stands there {listed.count(twice[0])} times")
    return columns


# A recorder's weights.csv: a row per quantity, a column per frame.

RECORDER_RATE = 60.0
"""[Hz] Where there are no timestamps, or these say nearly so."""
TIME, HEAD = "timestamp", ("head x", "head y", "head z", "head w")


def has_quantity_rows(text: str) -> bool:
    """Whether a CSV has the names of expressions down its first column rather than along its first line."""
    along, *rows = text.splitlines()
    comma = _delimiter(text)
    down = {arkit_name(line.split(comma, 1)[0].strip().strip('"')) for line in rows}
    return len(down - {None}) > sum(arkit_name(name.strip().strip('"')) is not None for name in along.split(comma))


def read_recorder(text: str) -> Take:
    """Read a recorder's CSV; InputError names line and quantity.

    As apps of this kind write it: a first row of frames' numbers (which may be longer than the rest), then rows that
    begin with a name: `timestamp` [s], the 52 weights, and `head x`, `head y`, `head z`, `head w`, a quaternion of the
    head from its pose in the first frame (ARKit's axes: x to the face's own left, y up, z forward, as ours). Rows stand
    in any order; those of the eyes and others are ignored.
    """
    named: dict[str, Row] = {}
    rows = _rows(text)
    if rows and not rows[0][1][0].strip():
        line, row = rows[0]
        numbered = Counter(cell.strip() for cell in row[1:] if cell.strip())
        if numbered.total() > len(numbered):
            frame, often = numbered.most_common(1)[0]
            raise InputError(f"line {line}: frame {quote(frame)} stands there {often} times")
        frames = [int(cell) for cell in numbered if cell.isascii() and cell.isdecimal()]
        if frames != sorted(frames):
            raise InputError(f"line {line}: expected frames whose numbers rise")
    for line, row in rows:
        name = row[0].strip()
        known = arkit_name(name) or name.lower()
        if known in named:
            raise InputError(f"line {line}: {known} stands in line {named[known][0]} already")
        if known in (*ARKIT, TIME, *HEAD):
            named[known] = line, row
    if not any(name in ARKIT for name in named):
        raise InputError("not a take: no line begins with one of ARKit's 52 expressions")
    counts = {len(row) for _, row in named.values()}
    if len(counts) > 1:
        line, row = next(row for row in named.values() if len(row[1]) != max(counts))
        raise InputError(f"line {line}: {len(row) - 1} frames, other quantities have {max(counts) - 1}")
    if counts == {1}:
        raise InputError("no frames, only the names")
    values = {
        name: np.array([_number(cell, f"line {line}, {name}, frame {k}") for k, cell in enumerate(row[1:])])
        for name, (line, row) in named.items()
    }
    names = [name for name in ARKIT if name in values]
    rate, times = _times_from_stamps(values.get(TIME), max(counts) - 1)
    _refuse_partial(HEAD, values)
    head = None
    if all(name in values for name in HEAD):
        quaternions = np.stack([values[name] for name in HEAD], axis=1)
        head = angles_from_rotations(rotations_from_quaternions("head, by frame", quaternions))
    return take_from_columns(np.stack([values[name] for name in names], axis=1), names, rate, times, head=head)


def _times_from_stamps(stamps: Floats | None, frames: int) -> tuple[float, Floats]:
    """The rate [Hz] and the frames' times [s], the first at 0."""
    if stamps is None:
        return RECORDER_RATE, np.arange(frames) / RECORDER_RATE
    steps = np.diff(stamps)
    if (steps <= 0).any():
        raise InputError(f"{TIME}, frame {int(np.argmax(steps <= 0)) + 1}: time does not rise")
    rate = 1.0 / float(np.median(steps)) if len(steps) else RECORDER_RATE
    return (RECORDER_RATE if abs(rate - RECORDER_RATE) < 1.0 else rate), stamps - stamps[0]


# JSON, as the data set BEAT and Audio2Face have it: the expressions' names, and frames of weights.


def read_json_take(text: str) -> Take:
    """Read a take in a JSON text, as BEAT's; InputError names frame and expression.

    {"names": ["jawOpen", ...], "frames": [{"weights": [0.2, ...], "time": 0.0}, ...]}

    Names are ARKit's, as `arkit_name` knows them, in any order; an unknown one is an error. Times [s] rise.
    """
    # Weights and times that are not finite are named with their frame.
    content = load_json(text, allow_nan=True)
    frames = _list_frames(content, "frames")
    names = _list_names(content.get("names"), "names")
    listed = [frame.get("weights") if isinstance(frame, dict) else None for frame in frames]
    values = np.array([_list_weights(row, f"frame {number}", names) for number, row in enumerate(listed)])
    stamps = np.array([_finite_number(frame.get("time"), f"frame {n}, time") for n, frame in enumerate(frames)])
    steps = np.diff(stamps)
    if not len(steps) or (steps <= 0).any():
        where = int(np.argmax(steps <= 0)) + 1 if len(steps) else 0
        raise InputError(f"frame {where}, time: expected two frames or more whose times rise")
    return take_from_columns(values, names, 1.0 / float(np.median(steps)), stamps - stamps[0])


def has_audio2face_weights(text: str) -> bool:
    """Whether a JSON text has the keys of Audio2Face's exports."""
    return '"facsNames"' in text and '"weightMat"' in text


def read_audio2face(text: str) -> Take:
    """Read weights that NVIDIA's Audio2Face exported for ARKit's 52; InputError names frame and expression.

    {"exportFps": 30, "facsNames": ["eyeBlinkLeft", ...], "weightMat": [[0.2, ...], ...]}
    """
    content = load_json(text, allow_nan=True)
    rows = _list_frames(content, "weightMat")
    names = _list_names(content.get("facsNames"), "facsNames")
    values = np.array([_list_weights(row, f"frame {number}", names) for number, row in enumerate(rows)])
    rate = _finite_number(content.get("exportFps"), "exportFps")
    check_rate(rate)
    return take_from_columns(values, names, rate, np.arange(len(rows)) / rate)


def _list_frames(content: Any, key: str) -> list[Any]:
    frames = content.get(key) if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f'not a take: expected an object with a list "{key}" that is not empty')
    TAKE_FRAMES.check(f'"{key}"', len(frames))
    return frames


def _list_weights(listed: Any, where: str, names: list[str]) -> list[float]:
    if not isinstance(listed, list) or len(listed) != len(names):
        raise InputError(f"{where}: expected a list of {len(names)} weights, one for each name")
    return [_finite_number(value, f"{where}, {name}") for value, name in zip(listed, names, strict=True)]


def _list_names(listed: Any, key: str) -> list[str]:
    if not isinstance(listed, list) or not listed:
        raise InputError(f'"{key}": expected the list of the expressions that each frame lists')
    names = [_find_name(name, key) for name in listed]
    twice = [name for name in ARKIT if names.count(name) > 1]
    if twice:
        raise InputError(f'"{key}": {twice[0]} stands there {names.count(twice[0])} times')
    return names


def _find_name(name: Any, where: str) -> str:
    known = arkit_name(str(name))
    if known is not None:
        return known
    try:
        return ARKIT[index(str(name))]
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _finite_number(value: Any, where: str) -> float:
    """A number of a JSON text; InputError for what is none, or not finite."""
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{where}: {quote(value)} is no finite number")
    return number


# Results of MediaPipe's face landmarker, as its tasks for Python and JavaScript give them, an object a frame.

SCORES = ("face_blendshapes", "faceBlendshapes")
STAMPS = ("timestamp_ms", "timestampMs", "timestamp")
NAMES = ("category_name", "categoryName")
NEUTRAL = "_neutral"
"""A category of MediaPipe's that is none of ARKit's, though its score is near zero."""
CAMERA_RATE = 30.0
"""[Hz] Rate of results without timestamps: a webcam's."""


def has_landmarker_results(text: str) -> bool:
    """Whether a JSON text names the face landmarker's scores."""
    return any(f'"{name}"' in text for name in SCORES)


def read_landmarker(text: str) -> Take:
    """Read results of MediaPipe's face landmarker; InputError names frame and category.

    {"face_blendshapes": [[{"index": 25, "score": 0.2, "category_name": "jawOpen"}, ...]], "timestamp_ms": 33}

    A frame is such an object, by Python's names or JavaScript's ("faceBlendshapes", "categoryName", a face's categories
    under "categories"). A text is a list of frames, {"frames": [...]}, one frame, or a frame a line. Timestamps
    are milliseconds. Frames whose list of faces is empty are left out and counted. Landmarks and the head's pose are
    not read.
    """
    results = _list_results(text)
    TAKE_FRAMES.check("it has", len(results))
    scores = [_scores_of(result, f"frame {number}") for number, result in enumerate(results)]
    there = np.array([named is not None for named in scores])
    if not there.any():
        raise InputError("no frames with a face")
    first = int(np.argmax(there))
    names = list(scores[first] or ())
    for number, named in enumerate(scores):
        differing = set(names if named is None else named).symmetric_difference(names)
        if differing:
            name = min(differing)
            has, lacks = (first, number) if name in names else (number, first)
            raise InputError(f"frame {lacks}: no category {name}, which frame {has} has")
    rate, times = _times_of_results(results)
    start = times[there][0]
    columns = np.array([[named[name] for name in names] for named in scores if named is not None])
    return take_from_columns(columns, names, rate, times[there] - start, lost_at=times[~there] - start)


def _list_results(text: str) -> list[Any]:
    """List the frames of a text; InputError names a line that is no JSON."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    first = lines[0][1].strip()
    if len(lines) > 1 and first.startswith("{") and first.endswith("}"):
        results = []
        for number, line in lines:
            try:
                results.append(load_json(line, allow_nan=True))
            except InputError as error:
                raise InputError(f"line {number}: {error}") from None
        return results
    content = load_json(text, allow_nan=True)
    if isinstance(content, dict):
        content = content["frames"] if "frames" in content else [content]
    if not isinstance(content, list) or not content:
        raise InputError("not a take: expected a list of face landmarker results that is not empty")
    return content


def _scores_of(result: Any, where: str) -> dict[str, float] | None:
    """Return a frame's scores by ARKit's names, None where it has no face."""
    faces = _named_one_of(result, SCORES) if isinstance(result, dict) else None
    if not isinstance(faces, list):
        raise InputError(f"{where}: expected an object with a list {SCORES[0]}, or {SCORES[1]}")
    if not faces:
        return None
    if len(faces) > 1:
        raise InputError(f"{where}: {len(faces)} faces, expected one")
    categories = faces[0].get("categories") if isinstance(faces[0], dict) else faces[0]
    if not isinstance(categories, list) or not categories:
        raise InputError(f"{where}: expected a list of categories, each with its name and score")
    scores: dict[str, float] = {}
    for number, category in enumerate(categories):
        name = _named_one_of(category, NAMES) if isinstance(category, dict) else None
        if not isinstance(name, str):
            raise InputError(f"{where}, category {number}: expected an object with {NAMES[0]}, or {NAMES[1]}")
        if name == NEUTRAL:
            continue
        known = _find_name(name, f"{where}, category {number}")
        if known in scores:
            raise InputError(f"{where}: category {known} stands there twice")
        scores[known] = _finite_number(category.get("score"), f"{where}, category {known}")
    if not scores:
        raise InputError(f"{where}: no category but {NEUTRAL}")
    return scores


def _times_of_results(results: Sequence[dict[str, Any]]) -> tuple[float, Floats]:
    """The rate [Hz] and the frames' times [s], by their timestamps [ms]."""
    stamps = [_named_one_of(result, STAMPS) for result in results]
    if all(stamp is None for stamp in stamps):
        return CAMERA_RATE, np.arange(len(results)) / CAMERA_RATE
    times = 1e-3 * np.array([_finite_number(stamp, f"frame {n}, timestamp") for n, stamp in enumerate(stamps)])
    steps = np.diff(times)
    if (steps <= 0).any():
        raise InputError(f"frame {int(np.argmax(steps <= 0)) + 1}, timestamp: time does not rise")
    if not len(steps):
        return CAMERA_RATE, times
    rate = 1.0 / float(np.median(steps))
    if not RATES[0] <= rate <= RATES[1]:
        raise InputError(
            f"timestamp: {rate:.6g} frames a second; expected milliseconds, at {RATES[0]:g} to {RATES[1]:g} Hz"
        )
    return rate, times


def _named_one_of(content: dict[str, Any], names: Sequence[str]) -> Any:
    """Return the first of some keys' values that is there, or None."""
    return next((content[name] for name in names if content.get(name) is not None), None)


# Both kinds of CSV share these.


def _delimiter(text: str) -> str:
    """Return what the first line is divided by most: a comma, a semicolon or a tab."""
    first = text.lstrip("\r\n").split("\n", 1)[0]
    return max(",;\t", key=first.count)


def _rows(text: str) -> list[Row]:
    """The lines of a CSV that hold anything, with points for decimal commas; Excel's line sep=; is none."""
    lines = csv.reader(io.StringIO(text, newline=None), delimiter=_delimiter(text))
    try:
        return [
            (number, [cell.replace(",", ".") for cell in row])
            for number, row in enumerate(lines, start=1)
            if any(row) and row[0] != "sep="
        ]
    except csv.Error as error:
        raise InputError(f"not a take ({error})") from None


def _number(cell: str, where: str) -> float:
    try:
        number = parse_number(cell)
    except ValueError:
        raise InputError(f"{where}: {quote(cell)!r} is no number") from None
    if not math.isfinite(number):
        raise InputError(f"{where}: {quote(cell)} is not finite")
    return number


def _refuse_partial(wanted: Sequence[str], present: Any) -> None:
    """Raise InputError where some of the head's angles are there and others are not; `present` in small letters."""
    lacking = [name for name in wanted if name.lower() not in present]
    if lacking and len(lacking) < len(wanted):
        there = ", ".join(name for name in wanted if name not in lacking)
        raise InputError(f"{there} without {', '.join(lacking)}: expected all of the head's angles, or none")


class Reader(NamedTuple):
    """A format of takes: its files' suffix, whether a text is of it, and what reads that."""

    suffix: str
    fits: Callable[[str], bool]
    read: Callable[[str], Take]


READERS = (
    Reader(".csv", has_quantity_rows, read_recorder),
    Reader(".csv", lambda text: True, read_livelink),
    Reader(".json", has_landmarker_results, read_landmarker),
    Reader(".json", has_audio2face_weights, read_audio2face),
    Reader(".json", lambda text: True, read_json_take),
    Reader(".jsonl", lambda text: True, read_landmarker),
)
"""The formats of takes; of a suffix the first that fits reads the text."""
