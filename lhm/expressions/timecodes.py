"""Times of frames by their timecodes, at whatever rate the device or the video counted.

SMPTE ST 12-1 describes timecode, and the drop-frame labels of 29.97 Hz.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError, quote
from ..base.mesh import Floats, Ints

USUAL_RATES = (24, 25, 30, 48, 50, 60, 100, 120, 240)
"""Labels a second, where labels alone leave it open."""
DROPPED = {30: 2, 60: 4, 120: 8}
"""First labels that drop-frame timecode skips in every minute but each tenth, by labels a second."""
SLOWED = 1000 / 1001
"""From 30 Hz to 29.97 Hz, as NTSC has it."""
_TIMECODE = re.compile(r"([01]?\d|2[0-3])[:;]([0-5]\d)[:;]([0-5]\d)([:;])(\d{1,3}(?:\.\d+)?)", re.ASCII)
_DAY = 24 * 3600


def times_from_timecodes(timecodes: Sequence[tuple[int, str]]) -> tuple[float, Floats]:
    """Find the rate [Hz] and the frames' times [s], shape (n,), the first at 0.

    `timecodes`: a file's line and its label HH:MM:SS:FF.fff, n times. FF counts frames since the second; how many a
    second has is seen where one ends and the next begins. Drop-frame labels, told by a semicolon or by those that are
    skipped at a minute, are of 29.97 or 59.94 Hz. Frames that are counted without a hole are evenly spaced, also at a
    rate that is no whole number. A take within one second is of 60 labels a second. Raises InputError, which names the
    line, for labels that are none, do not rise, or lie beyond their second's end.
    """
    seconds, frames, semicolon = _parse(timecodes)

    def refuse(number: int, words: str) -> InputError:
        return InputError(f"line {timecodes[number][0]}, column Timecode: {words}")

    same = np.diff(seconds) == 0
    falls = (np.diff(seconds) < 0) | (same & (np.diff(frames) <= 0))
    if falls.any():
        raise refuse(int(np.argmax(falls)) + 1, "time does not rise")
    step = _usual_step(np.diff(frames)[same])
    largest = int(frames.argmax())
    labels = _count_labels(seconds, frames, step)
    if labels is None:
        raise refuse(largest, f"frame {int(frames[largest])}, expected below {USUAL_RATES[-1]}")
    if frames[largest] >= labels + max(step, 1.0):
        raise refuse(largest, f"frame {int(frames[largest])}, but most seconds end before it")
    if _is_drop_frame(seconds, frames, labels, step, semicolon):
        minutes = seconds // 60
        count = seconds * labels + frames - DROPPED[labels] * (minutes - minutes // 10)
        return labels * SLOWED / step, (count - count[0]) / (labels * SLOWED)
    rate = _find_even_rate(seconds, frames)
    if rate is not None:
        return rate, np.arange(len(frames)) / rate
    ends = np.where(frames >= labels, np.floor(frames) + 1, labels)  # a second may have one frame more than most
    own = np.maximum.reduceat(ends, np.flatnonzero(np.r_[True, ~same]))[np.cumsum(np.r_[False, ~same])]
    times = seconds + frames / own
    return labels / step, times - times[0]


def _parse(timecodes: Sequence[tuple[int, str]]) -> tuple[Ints, Floats, bool]:
    """Return seconds, which go on over midnight, frames since the second, and whether any stand after a semicolon."""
    seconds, frames = np.empty(len(timecodes), int), np.empty(len(timecodes))
    semicolon = False
    for number, (line, timecode) in enumerate(timecodes):
        match = _TIMECODE.fullmatch(timecode.strip())
        if match is None:
            raise InputError(f"line {line}, column Timecode: {quote(timecode)!r}, expected HH:MM:SS:FF.fff")
        hour, minute, second, mark, frame = match.groups()
        seconds[number] = 3600 * int(hour) + 60 * int(minute) + int(second)
        frames[number] = float(frame)
        semicolon |= mark == ";"
    days = np.concatenate([[0], np.cumsum(np.diff(seconds) < -_DAY // 2)])
    return seconds + _DAY * days, frames, semicolon


def _usual_step(steps: Floats) -> float:
    """Average the steps of frames within a second, less those over a hole; to 0.01, as devices' clocks shake."""
    steps = steps[steps < 1.75 * np.median(steps)] if len(steps) else np.ones(1)
    return max(round(float(steps.mean()), 2), 0.01)


def _starts_short_minute(seconds: Ints) -> NDArray[np.bool_]:
    """Mark the seconds whose first labels drop-frame timecode skips."""
    return (seconds % 60 == 0) & (seconds % 600 != 0)


def _count_labels(seconds: Ints, frames: Floats, step: float) -> int | None:
    """Count the labels of a second; None for more than any usual rate has."""
    last = np.flatnonzero(np.diff(seconds) == 1)
    ends, begins = frames[last] + step, frames[last + 1]
    skipped = np.zeros(len(last))
    for labels, dropped in DROPPED.items():
        skipped[_starts_short_minute(seconds[last + 1]) & (np.abs(ends - labels) < 0.5 * step)] = dropped
    begins = np.where(begins >= skipped, begins - skipped, begins)
    whole = begins < step  # no label can be missing before it
    if whole.any():
        found = float(np.median((ends - begins)[whole]))
        usual = min(USUAL_RATES, key=lambda rate: abs(rate - found))
        return usual if abs(usual - found) < 0.75 * step else max(round(found), 1)
    least = 24 if np.ptp(seconds) > 1 else 60
    return next((rate for rate in USUAL_RATES if rate > int(frames.max()) and rate >= least), None)


def _is_drop_frame(seconds: Ints, frames: Floats, labels: int, step: float, semicolon: bool) -> bool:
    """Return whether labels are drop-frame: none that these skip is there, and a semicolon or such a minute tells."""
    short = _starts_short_minute(seconds)
    if labels not in DROPPED or (short & (frames < DROPPED[labels])).any():
        return False
    across = short[1:] & (np.diff(seconds) == 1)
    skipping = frames[1:] - frames[:-1] + labels - DROPPED[labels] < 1.5 * step
    return semicolon or bool((across & skipping).any())


def _find_even_rate(seconds: Ints, frames: Floats) -> float | None:
    """Find the rate at which frames are counted evenly without a hole, and each second's first label is below 1.

    A whole number is taken before one of NTSC's, and that before the middle of what labels allow; None where there are
    holes, or where all lies within a second.
    """
    after = seconds - seconds[0]
    rises, begins = np.diff(frames), np.diff(seconds)
    even = np.abs(rises[begins == 0] - 1.0) < 2e-3
    if not after[-1] or (begins > 1).any() or not even.all() or (frames[1:][begins == 1] >= 1.0).any():
        return None
    ahead = frames[0] + np.arange(len(frames)) - frames
    fraction = (frames - frames[0]) % 1.0
    rounds_down = (np.minimum(fraction, 1.0 - fraction) < 2e-3).all()
    beyond = after > 0
    most = float((ahead[beyond] / after[beyond]).min())
    least = float(((ahead[beyond] - (1.0 if rounds_down else 0.01)) / after[beyond]).max())
    nearest = round(most)
    for rate in (nearest, nearest * SLOWED, 0.5 * (least + most)):
        if least < rate <= most + 2e-3:
            return float(rate)
    return None
