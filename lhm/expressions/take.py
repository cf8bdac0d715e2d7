"""Takes: recorded ARKit weights over time, read from LiveLink Face's CSV or from JSON."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arkit import ARKIT
from ..errors import InputError
from ..mesh import Floats


@dataclass(frozen=True, eq=False)
class Take:
    """Weights in ARKit's order, shape (frames, 52), in [0, 1], at `times` [s], shape (frames,), rising.

    `rate` [Hz] is the usual number of frames per second; dropped frames show in `times`. `clipped` says how many values
    lay outside [0, 1] where they came from, `missing` which of the 52 were not there and are zero. Raises InputError
    for other shapes, weights outside [0, 1] or not finite, and times that do not rise.
    """

    weights: Floats
    rate: float
    times: Floats
    clipped: int = 0
    missing: tuple[str, ...] = ()

    def __post_init__(self):
        weights, times = (np.array(values, dtype=np.float64) for values in (self.weights, self.times))
        if weights.ndim != 2 or weights.shape[1] != len(ARKIT) or not len(weights):
            raise InputError(f"take: expected weights of shape (frames, {len(ARKIT)}), got {weights.shape}")
        bad = np.argwhere(~((weights >= 0.0) & (weights <= 1.0)))
        if len(bad):
            value = weights[tuple(bad[0])]
            raise InputError(f"take: {ARKIT[bad[0, 1]]} is {value:g} in frame {bad[0, 0]}, expected 0..1")
        if times.shape != (len(weights),) or not np.isfinite(times).all():
            raise InputError(f"take: expected {len(weights)} finite times, got shape {times.shape}")
        if (np.diff(times) <= 0).any():
            raise InputError(f"take: time does not rise at frame {np.flatnonzero(np.diff(times) <= 0)[0] + 1}")
        check_rate(self.rate)
        for name, values in (("weights", weights), ("times", times)):
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    @property
    def duration(self) -> float:
        """From the first frame to the last [s]."""
        return float(self.times[-1] - self.times[0])


def check_rate(rate: float) -> None:
    """Raise InputError unless a frame rate [Hz] is finite and positive."""
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"rate: {rate:g} Hz, expected a finite number above 0")


def read_take(path: str | os.PathLike[str]) -> Take:
    """A take from a LiveLink Face CSV (see `livelink`) or a JSON file (see `take_json`), by its suffix.

    Values outside [0, 1] are clipped and counted, expressions that the file lacks are zero and named: both stand in the
    Take. Raises InputError, one line that names the file and, where there are such, line or frame and column.
    """
    from .livelink import parse_csv
    from .take_json import parse_json

    parsers = {".csv": parse_csv, ".json": parse_json}
    path = Path(path)
    parse = parsers.get(path.suffix.lower())
    if parse is None:
        raise InputError(f"{path}: unknown kind of file; expected one of {', '.join(parsers)}")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise InputError(f"{path}: cannot be read ({reason})") from None
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    try:
        return parse(text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def take_of(columns: Floats, names: list[str], rate: float, times: Floats) -> Take:
    """A Take of values, shape (frames, len(names)), whose columns are the expressions named; clipped and counted."""
    weights = np.zeros((len(columns), len(ARKIT)))
    weights[:, [ARKIT.index(name) for name in names]] = columns
    clipped = int(np.count_nonzero((weights < 0.0) | (weights > 1.0)))
    missing = tuple(name for name in ARKIT if name not in names)
    return Take(np.clip(weights, 0.0, 1.0), rate, times, clipped, missing)


def resampled(take: Take, rate: float) -> Take:
    """The take at evenly spaced times from its first to its last, `rate` [Hz].

    Between frames the weights are linear in time. Where the rate rises or stays, they are read off there; where it
    falls, they are averaged exactly over 1/rate around each new time (as much of it as lies within the take), so that
    what is faster than the new rate fades rather than folds back. Raises InputError for a rate that is not positive.
    """
    check_rate(rate)
    start, end = take.times[0], take.times[-1]
    times = start + np.arange(int(np.floor((end - start) * rate + 1e-6)) + 1) / rate
    times = np.minimum(times, end)
    if rate >= take.rate * (1.0 - 1e-6) or len(take.times) == 1:
        weights = np.stack([np.interp(times, take.times, column) for column in take.weights.T], axis=1)
    else:
        left, right = np.maximum(times - 0.5 / rate, start), np.minimum(times + 0.5 / rate, end)
        weights = (_integral(take, right) - _integral(take, left)) / (right - left)[:, None]
    return Take(np.clip(weights, 0.0, 1.0), float(rate), times, take.clipped, take.missing)


def _integral(take: Take, until: Floats) -> Floats:
    """The integral of the piecewise linear weights from the first frame to each time, shape (times, 52)."""
    steps = np.diff(take.times)
    slopes = np.diff(take.weights, axis=0) / steps[:, None]
    whole = np.cumsum(0.5 * (take.weights[1:] + take.weights[:-1]) * steps[:, None], axis=0)
    before = np.vstack([np.zeros((1, whole.shape[1])), whole])
    frame = np.clip(np.searchsorted(take.times, until, side="right") - 1, 0, len(steps) - 1)
    rest = (until - take.times[frame])[:, None]
    return before[frame] + rest * (take.weights[frame] + 0.5 * rest * slopes[frame])
