"""A pool of takes to draw expressions from: recorded, spoken, made up. A corpus is split by them, not by their frames.

Each is known by its name alone: "real/FILE" is read from a folder, "speech/07" is the eighth of the shipped sentences,
"conversation/3", "random/3" and "hard/3" follow from their number and length. All are given at one rate.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.limits import RECORDED_FILES, RECORDINGS
from ..base.mesh import Ints
from .made_up import PACE, combinations, conversation_take, hard_expressions, shipped_sentences, speech
from .readers import read_take
from .takes import Take, check_frames, resample

Kind = Literal["real", "speech", "conversation", "random", "hard"]
RATE = 60.0
SECONDS = 60.0
SUFFIXES = (".csv", ".json", ".jsonl")


@dataclass(frozen=True)
class Recording:
    """A take that can be had again by what stands here: `frames` in all at `rate` [Hz].

    `origin` is the file's path, the text spoken, or the seed of what is made up; `pace` [1/s] that of speech.
    """

    name: str
    kind: Kind
    frames: int
    rate: float
    origin: str
    pace: float = PACE

    def take(self) -> Take:
        """Make the take, evenly spaced at `rate`; InputError where its file is gone or has another length by now."""
        take = _make(self.kind, self.origin, self.frames, self.rate, self.pace)
        if len(take.times) != self.frames:
            raise InputError(
                f"recording {self.name!r}: {len(take.times)} frames at {self.rate:g} Hz, not {self.frames}"
            )
        return take


def recordings(
    folder: str | os.PathLike[str] | None = None,
    *,
    spoken: Sequence[str] | None = None,
    conversations: int = 8,
    random: int = 8,
    hard: int = 0,
    seconds: float = SECONDS,
    rate: float = RATE,
    pace: float = PACE,
) -> dict[str, Recording]:
    """List recordings by name, in a fixed order: real ones, speech, conversations, random combinations, hard ones.

    `folder`: where CSV and JSON takes are looked for, at any depth; a file that is none is left out with a warning.
    `spoken`: texts, by default the shipped ones; () for none. `conversations`, `random`, `hard`: how many, each of
    `seconds`; frames of a hard one have no order in time. Raises InputError for a folder that is not there or has no
    take, counts beyond `limits.RECORDINGS`, and what `speech` and the makers raise.
    """
    for name, count in (("conversations", conversations), ("random", random), ("hard", hard)):
        RECORDINGS.check(name, count)
    check_frames(seconds * rate, rate)
    frames = round(seconds * rate)
    pool = [] if folder is None else _real(Path(folder), rate)
    spoken = shipped_sentences() if spoken is None else spoken
    RECORDINGS.check("spoken", len(spoken))
    for number, text in enumerate(spoken):
        count = len(_make("speech", text, 0, rate, pace).times)
        pool.append(Recording(f"speech/{number:02d}", "speech", count, rate, text, pace))
    pool += [Recording(f"conversation/{k}", "conversation", frames, rate, str(k)) for k in range(conversations)]
    pool += [Recording(f"random/{k}", "random", frames, rate, str(k)) for k in range(random)]
    pool += [Recording(f"hard/{k}", "hard", frames, rate, str(k)) for k in range(hard)]
    return {recording.name: recording for recording in pool}


def starts(take: Take, length: int) -> Ints:
    """Find where `length` consecutive frames can begin, shape (k,), with none of them in a gap of the take."""
    real = _find_recorded(take)
    before = np.concatenate([[0], np.cumsum(real)])
    return np.flatnonzero(before[length:] - before[:-length] == length) if length <= len(real) else np.zeros(0, int)


def _find_recorded(take: Take) -> NDArray[np.bool_]:
    """Mark the frames that are not made up across a gap, shape (frames,)."""
    inside = np.zeros(len(take.times), dtype=bool)
    for begin, end in take.gaps:
        inside |= (take.times > begin) & (take.times < end)
    return ~inside


def _real(folder: Path, rate: float) -> list[Recording]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    takes = []
    files = (path for path in folder.rglob("[!.]*") if path.suffix.lower() in SUFFIXES and path.is_file())
    paths = sorted(islice(files, RECORDED_FILES.most + 1))
    RECORDED_FILES.check(str(folder), len(paths))
    for path in paths:
        try:
            count = len(resample(read_take(path), rate).times)
        except InputError as error:
            warnings.warn(f"left out of the recordings: {error}", stacklevel=3)
            continue
        name = f"real/{path.relative_to(folder).as_posix()}"
        takes.append(Recording(name, "real", count, rate, str(path.resolve())))
    if not takes:
        raise InputError(f"{folder}: no take in it, {' or '.join(SUFFIXES)}")
    return takes


def _make(kind: Kind, origin: str, frames: int, rate: float, pace: float) -> Take:
    if kind == "real":
        return resample(read_take(origin), rate)
    if kind == "speech":
        return resample(speech(origin, pace=pace), rate)
    rng, times = np.random.default_rng(int(origin)), np.arange(frames) / rate
    if kind == "conversation":
        return conversation_take(rng, frames, rate=rate)
    if kind == "hard":
        return Take(hard_expressions(rng, frames), rate, times, synthetic="hard expressions")
    return Take(combinations(rng, frames, rate=rate), rate, times, synthetic="random combinations")
