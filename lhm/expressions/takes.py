"""Takes: ARKit weights and head angles over time, and at other times."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..base.checks import finite
from ..base.errors import InputError
from ..base.limits import TAKE_FRAMES
from ..base.mesh import Floats
from ..identities.arkit import ARKIT

FEW = 5
GAP = 0.1
"""Frames further apart than this [s] have something missing between them."""
RATES = 0.25, 1000.0
"""[Hz] Least and greatest. Milliseconds taken for seconds make 24 to 240 Hz less; cameras end there."""


@dataclass(frozen=True, eq=False)
class Take:
    """Weights in ARKit's order, shape (frames, 52), in [0, 1], at `times` [s], shape (frames,), rising.

    `rate` [Hz] is the usual number of frames per second; dropped frames show in `times`. `missing`: which of the 52
    were not there and are zero. `head` [rad], shape (frames, 3), or None: the head's yaw, pitch and roll (see
    `rotations`). `clipped_at`, `lost_at` [s], shape (k,): when a value lay outside [0, 1] where it came from, and
    when a frame was left out since it had no face. `gaps` [s], shape (k, 2): from when to when frames were made up
    between two that were recorded. `synthetic`: what made the take up, or "". Raises InputError for other shapes,
    weights outside [0, 1] or not finite, angles not finite, and times that do not rise.
    """

    weights: Floats
    rate: float
    times: Floats
    missing: tuple[str, ...] = ()
    head: Floats | None = None
    clipped_at: Floats = field(default_factory=lambda: np.zeros(0))
    lost_at: Floats = field(default_factory=lambda: np.zeros(0))
    gaps: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    synthetic: str = ""

    def __post_init__(self):
        weights, times = (np.array(values, dtype=np.float64) for values in (self.weights, self.times))
        if weights.ndim != 2 or weights.shape[1] != len(ARKIT) or not len(weights):
            raise InputError(f"take: expected weights of shape (frames, {len(ARKIT)}), got {weights.shape}")
        TAKE_FRAMES.check("take", len(weights))
        bad = np.argwhere(~((weights >= 0.0) & (weights <= 1.0)))
        if len(bad):
            value = weights[tuple(bad[0])]
            raise InputError(f"take: {ARKIT[bad[0, 1]]} is {value:g} in frame {bad[0, 0]}, expected 0..1")
        finite("take: times", times, (len(weights),))
        if (np.diff(times) <= 0).any():
            raise InputError(f"take: time does not rise at frame {np.flatnonzero(np.diff(times) <= 0)[0] + 1}")
        check_rate(self.rate)
        arrays = {"weights": weights, "times": times}
        if self.head is not None:
            arrays["head"] = np.array(finite("take: angles", self.head, (len(weights), 3)))
        for name, values in arrays.items():
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    @property
    def clipped(self) -> int:
        """The number of values that lay outside [0, 1] where they came from."""
        return len(self.clipped_at)

    @property
    def lost(self) -> int:
        """The number of frames that were left out since they had no face."""
        return len(self.lost_at)

    def part(self, chosen: slice) -> Take:
        """Keep some of the frames, with what is counted in their time alone; InputError if there are none."""
        times = self.times[chosen]
        if not len(times):
            raise InputError(f"take: none of its {len(self.times)} frames")
        first, last = times[0] - 0.5 / self.rate, times[-1] + 0.5 / self.rate
        return replace(
            self,
            weights=self.weights[chosen],
            times=times,
            head=None if self.head is None else self.head[chosen],
            clipped_at=self.clipped_at[(self.clipped_at >= first) & (self.clipped_at < last)],
            lost_at=self.lost_at[(self.lost_at >= first) & (self.lost_at < last)],
            gaps=self.gaps[(self.gaps[:, 1] > times[0]) & (self.gaps[:, 0] < times[-1])],
        )

    def remarks(self) -> tuple[str, ...]:
        """Say what a user should know of the take, a line each; what there is nothing of is left out."""
        few = ", ".join(self.missing[:FEW]) + (", ..." if len(self.missing) > FEW else "")
        bridged = "; the weights between are read off a line" if len(self.gaps) else ""
        remarks = (
            (self.clipped, f"{self.clipped} weights outside [0, 1] clipped"),
            (self.lost, f"{self.lost} frames without a face left out{bridged}"),
            (self.missing, f"{len(self.missing)} expressions are missing, and zero ({few})"),
        )
        return tuple(text for there, text in remarks if there)


def check_rate(rate: float) -> None:
    """Raise InputError unless a frame rate [Hz] lies within RATES."""
    if not RATES[0] <= rate <= RATES[1]:
        hint = "; are its times milliseconds?" if 0.0 < rate < RATES[0] else ""
        raise InputError(f"rate: {rate:.6g} Hz, expected {RATES[0]:g} to {RATES[1]:,g}{hint}")


def check_frames(frames: float, rate: float) -> None:
    """Raise InputError unless a take can have so many frames at this rate [Hz], see `limits.TAKE_FRAMES`."""
    check_rate(rate)
    TAKE_FRAMES.check("take", round(frames) if np.isfinite(frames) else TAKE_FRAMES.most + 1)


def take_from_columns(
    columns: Floats,
    names: list[str],
    rate: float,
    times: Floats,
    *,
    head: Floats | None = None,
    lost_at: Floats | None = None,
) -> Take:
    """Make a Take of values (frames, len(names)) whose columns are the expressions named; clipped and counted."""
    weights = np.zeros((len(columns), len(ARKIT)))
    weights[:, [ARKIT.index(name) for name in names]] = columns
    outside = np.count_nonzero((weights < 0.0) | (weights > 1.0), axis=1)
    return Take(
        np.clip(weights, 0.0, 1.0),
        rate,
        times,
        tuple(name for name in ARKIT if name not in names),
        head,
        clipped_at=np.repeat(times, outside),
        lost_at=np.zeros(0) if lost_at is None else lost_at,
    )


def resample(take: Take, rate: float) -> Take:
    """Give the take at evenly spaced times from its first to its last, `rate` [Hz].

    Between frames weights and head are linear in time, also where frames were lost: what is further apart than GAP
    stands in `gaps`. Where the rate rises or stays, they are read off there; where it falls, they are averaged exactly
    over 1/rate around each new time (as much of it as lies within the take), so that what is faster than the new rate
    fades rather than folds back. Raises InputError for a rate outside RATES.
    """
    start, end = take.times[0], take.times[-1]
    check_frames(1 + (end - start) * rate, rate)
    times = start + np.arange(int(np.floor((end - start) * rate + 1e-6)) + 1) / rate
    times = np.minimum(times, end)
    weights = _sample(take, take.weights, times, rate)
    head = None if take.head is None else _sample(take, take.head, times, rate)
    return replace(take, weights=np.clip(weights, 0.0, 1.0), rate=float(rate), times=times, head=head, gaps=_gaps(take))


def _gaps(take: Take) -> Floats:
    wide = np.flatnonzero(np.diff(take.times) > max(GAP, 1.5 / take.rate))
    return np.concatenate([take.gaps, np.stack([take.times[wide], take.times[wide + 1]], axis=1)])


def _sample(take: Take, values: Floats, times: Floats, rate: float) -> Floats:
    """Values of the take's frames, shape (frames, k), at other times."""
    if rate >= take.rate * (1.0 - 1e-6) or len(take.times) == 1:
        return np.stack([np.interp(times, take.times, column) for column in values.T], axis=1)
    left = np.maximum(times - 0.5 / rate, take.times[0])
    right = np.minimum(times + 0.5 / rate, take.times[-1])
    return (_integral(take.times, values, right) - _integral(take.times, values, left)) / (right - left)[:, None]


def _integral(times: Floats, values: Floats, until: Floats) -> Floats:
    """The integral of the piecewise linear values from the first time to each of others, shape (others, k)."""
    steps = np.diff(times)
    slopes = np.diff(values, axis=0) / steps[:, None]
    whole = np.cumsum(0.5 * (values[1:] + values[:-1]) * steps[:, None], axis=0)
    before = np.vstack([np.zeros((1, whole.shape[1])), whole])
    frame = np.clip(np.searchsorted(times, until, side="right") - 1, 0, len(steps) - 1)
    rest = (until - times[frame])[:, None]
    return before[frame] + rest * (values[frame] + 0.5 * rest * slopes[frame])


def rotations(angles) -> Floats:
    """Make rotation matrices R, shape (frames, 3, 3), of yaw, pitch and roll [rad], shape (frames, 3).

    R = Ry(yaw) Rx(pitch) Rz(roll) takes the head's own frame to the room's. Axes as everywhere: x to the subject's
    left, y up, z forward. Positive yaw turns the face to the subject's left, positive pitch downward, positive roll
    tilts it towards the subject's right shoulder.
    """
    values = np.asarray(angles, dtype=np.float64)
    (sy, sp, sr), (cy, cp, cr) = np.sin(values.T), np.cos(values.T)
    rows = (
        (cy * cr + sy * sp * sr, sy * sp * cr - cy * sr, sy * cp),
        (cp * sr, cp * cr, -sp),
        (cy * sp * sr - sy * cr, sy * sr + cy * sp * cr, cy * cp),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def angles_from_rotations(matrices) -> Floats:
    """Yaw, pitch and roll [rad], shape (frames, 3), of rotation matrices; each without jumps from frame to frame."""
    r = np.asarray(matrices, dtype=np.float64)
    yaw, roll = np.arctan2(r[:, 0, 2], r[:, 2, 2]), np.arctan2(r[:, 1, 0], r[:, 1, 1])
    return np.unwrap(np.stack([yaw, np.arcsin(np.clip(-r[:, 1, 2], -1.0, 1.0)), roll], axis=1), axis=0)
