"""Takes as JSON: an object with `frames`, and `rate` (or `fps`) [Hz] unless the frames carry their times.

    {"rate": 30, "frames": [{"jawOpen": 0.2, "mouthFunnel": 0.1}, {}, ...]}     what is not named is 0
    {"rate": 30, "names": ["jawOpen", ...], "frames": [[0.2, ...], ...]}        one value per name
    {"names": ["jawOpen", ...], "frames": [{"weights": [0.2, ...], "time": 0.0}, ...]}     times [s], as BEAT has them

Names are ARKit's, whatever their order and case; an unknown one is an error. Of `rate` and `time` the times win.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..arkit import ARKIT
from ..base.errors import InputError, quote
from ..base.files.text import parse_json as from_json
from ..base.limits import TAKE_FRAMES
from ..base.mesh import Floats
from .blending import index
from .take import Take, check_rate, take_of

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
