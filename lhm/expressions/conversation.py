"""Made-up talk: weights with the rhythm of a conversation, for training where no recordings are at hand.

Turns of talk and of listening follow one another. In talk, 3 to 6 syllables per second each draw the mouth to a
consonant and then to a vowel; smoothing over 35 ms lets neighbours colour one another (coarticulation). Mood, brows and
sideways motion are Ornstein-Uhlenbeck processes whose sign chooses the expression, so that of a contradictory pair
(left or right, smile or frown) one is always zero. Now and then mood rises to a broad smile, during which the lips are
less rounded. Eyes fixate, mostly ahead and sometimes far aside, and lids follow them down; most blinks close the lids.
A conversation of 2 s or more holds a blink that closes them in at least one frame, and a broad smile; a shorter one has
them where there is room. The figures are chosen by us, to have the range and speed of a recorded take.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from ..arkit import ARKIT
from ..base.checks import check_arguments
from ..base.mesh import Floats
from .head_motion import head_motion
from .take import Take, check_frames

# Mouth targets at full effort; names without a side stand for both sides.
CONSONANTS: tuple[dict[str, float], ...] = (
    {"jawOpen": 0.25, "mouthClose": 0.25, "mouthPress": 0.3, "mouthRollUpper": 0.2, "mouthRollLower": 0.25},  # m b p
    {"jawOpen": 0.15, "mouthClose": 0.15, "mouthPress": 0.25, "cheekPuff": 0.2, "mouthPucker": 0.15},  # p, plosive
    {"jawOpen": 0.1, "mouthRollLower": 0.35, "mouthUpperUp": 0.2, "mouthShrugLower": 0.2},  # f v
    {"jawOpen": 0.18, "mouthUpperUp": 0.15, "mouthLowerDown": 0.25, "mouthStretch": 0.2},  # t d n
    {"jawOpen": 0.2, "mouthLowerDown": 0.3, "mouthUpperUp": 0.15, "tongueOut": 0.15},  # l th
    {"jawOpen": 0.06, "jawForward": 0.12, "mouthStretch": 0.3, "mouthLowerDown": 0.3, "mouthDimple": 0.1},  # s z
    {"jawOpen": 0.1, "jawForward": 0.15, "mouthFunnel": 0.55, "mouthPucker": 0.2, "mouthShrugUpper": 0.2},  # sh
    {"jawOpen": 0.25, "mouthUpperUp": 0.1, "mouthLowerDown": 0.15},  # k g
    {"jawOpen": 0.15, "mouthFunnel": 0.35, "mouthPucker": 0.35},  # r w
)
VOWELS: tuple[dict[str, float], ...] = (
    {"jawOpen": 0.65, "mouthLowerDown": 0.35, "mouthUpperUp": 0.2},  # a
    {"jawOpen": 0.35, "mouthStretch": 0.3, "mouthLowerDown": 0.4, "mouthUpperUp": 0.25, "mouthDimple": 0.15},  # e
    {"jawOpen": 0.15, "mouthStretch": 0.4, "mouthLowerDown": 0.35, "mouthDimple": 0.25},  # i
    {"jawOpen": 0.4, "mouthFunnel": 0.5, "mouthPucker": 0.3},  # o
    {"jawOpen": 0.15, "mouthFunnel": 0.3, "mouthPucker": 0.7},  # u
    {"jawOpen": 0.3, "mouthLowerDown": 0.2, "mouthShrugLower": 0.1},  # schwa
)
REST = {"mouthPress": 0.08, "mouthShrugLower": 0.1, "mouthShrugUpper": 0.08, "mouthRollLower": 0.05}
ROUNDED = ("mouthPucker", "mouthFunnel", "mouthPress", "mouthRollLower", "mouthRollUpper")
SYLLABLES = (3.0, 6.0)  # [1/s]
TALK, LISTEN = (2.0, 7.0), (0.8, 4.0)  # [s]
BLINK_EVERY, BLINK_LASTS = (2.0, 6.0), (0.12, 0.4)  # [s]
CLOSED_SHARE, PARTLY = 0.8, (0.6, 0.95)  # of the blinks; how far the others go
FALL, HELD = 0.3, 0.2  # of a blink: lids going down, and staying closed
SMILE_EVERY, SMILE_LASTS, SMILE_RISES = (6.0, 16.0), (1.0, 3.5), (0.25, 0.5)  # [s]
BROAD = (0.75, 1.0)
GLANCES, GLANCE = 0.2, 2.5  # share of fixations far aside, and how much farther they are
LIDS_FOLLOW = 0.4  # eyeBlink per eyeLookDown; 0.67 over a recorded take, in which lids also close for other reasons
COARTICULATION = 0.035  # [s]
UNEVEN = 0.08


@check_arguments
def conversation(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Floats:
    """Weights like those of a conversation, in ARKit's order, shape (frames, 52), in [0, 1], `rate` [Hz].

    The same generator state gives the same weights. Of contradictory pairs (jawLeft and jawRight, mouthLeft and
    mouthRight, smile and frown, up and down, in and out of a gaze) one is zero, eyeWide fades while the eye blinks,
    mouthClose is at most jawOpen. Raises InputError for fewer than one frame and a rate that is not positive.
    """
    check_frames(frames, rate)
    face = _Face(rng, frames, rate)
    talking = _turns(rng, face.times)
    smile = _smiles(face, rng)
    _mouth(face, rng, talking, 1.0 - 0.8 * smile)
    _mood(face, talking, smile)
    _brows_and_nose(face, talking)
    _eyes(face, rng)
    return face.weights()


@check_arguments
def conversation_take(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Take:
    """A conversation's weights as a take at `rate` [Hz] whose head moves as a talker's (see `head_motion`)."""
    weights = conversation(rng, frames, rate=rate)
    head = head_motion(rng, frames, rate=rate)
    return Take(weights, rate, np.arange(frames) / rate, head=head, synthetic="made-up conversation")


class _Face:
    """The weights under construction: by name, where a name without a side adds to both sides, nearly alike."""

    def __init__(self, rng: np.random.Generator, frames: int, rate: float):
        self.rng, self.frames, self.rate = rng, frames, rate
        self.times = np.arange(frames) / rate
        self.values = {name: np.zeros(frames) for name in ARKIT}

    def add(self, name: str, values: Floats) -> None:
        """Add to one expression, or to both of a pair, each by a slowly changing factor near 1."""
        if name in self.values:
            self.values[name] = self.values[name] + values
            return
        for side in ("Left", "Right"):
            self.values[name + side] = self.values[name + side] + values * (1.0 + self.wander(3.0, UNEVEN))

    def split(self, name: str, opposite: str, signed: Floats) -> None:
        """Positive values to one expression and negative ones to its opposite."""
        self.add(name, np.maximum(signed, 0.0))
        self.add(opposite, np.maximum(-signed, 0.0))

    def wander(self, seconds: float, deviation: float) -> Floats:
        """A stationary Ornstein-Uhlenbeck process around 0 with this correlation time, smoothed, shape (frames,)."""
        keep = float(np.exp(-1.0 / (seconds * self.rate)))
        noise = self.rng.standard_normal(self.frames + 1) * np.sqrt(1.0 - keep**2)
        walk = lfilter([1.0], [1.0, -keep], noise[1:], zi=[keep * noise[0] / np.sqrt(1.0 - keep**2)])[0]
        return deviation * self.smooth(walk, min(0.1 * seconds, 0.1))

    def smooth(self, values: Floats, seconds: float) -> Floats:
        """Averaged over a Gaussian of this deviation [s]."""
        return gaussian_filter1d(values, seconds * self.rate, axis=0, mode="nearest")

    def weights(self) -> Floats:
        """All in ARKit's order, in [0, 1], shape (frames, 52)."""
        self.values["mouthClose"] = np.minimum(self.values["mouthClose"], self.values["jawOpen"])
        return np.clip(np.stack([self.values[name] for name in ARKIT], axis=1), 0.0, 1.0)


def _turns(rng: np.random.Generator, times: Floats) -> Floats:
    """1 where this face talks and 0 where it listens, shape (frames,)."""
    starts, talks = [-rng.uniform(*TALK)], rng.random() < 0.5
    states = [talks]
    while starts[-1] <= times[-1]:
        starts.append(starts[-1] + rng.uniform(*(TALK if states[-1] else LISTEN)))
        states.append(not states[-1])
    return np.array(states, dtype=np.float64)[np.searchsorted(starts, times, side="right") - 1]


def _smiles(face: _Face, rng: np.random.Generator) -> Floats:
    """How broad the smile is, shape (frames,): zero but for some seconds now and then, first within SMILE_EVERY."""
    broad = np.zeros(face.frames)
    until = float(face.times[-1])
    length = min(rng.uniform(*SMILE_LASTS), max(0.75 * until, 1.0 / face.rate))
    start = rng.uniform(0.0, max(min(until, SMILE_EVERY[1]) - length, 0.0))
    while start <= until:
        rise = min(rng.uniform(*SMILE_RISES), 0.4 * length)
        part = np.clip(np.minimum(face.times - start, start + length - face.times) / rise, 0.0, 1.0)
        broad = np.maximum(broad, rng.uniform(*BROAD) * part * part * (3.0 - 2.0 * part))
        start += length + rng.uniform(*SMILE_EVERY)
        length = rng.uniform(*SMILE_LASTS)
    return broad


def _mouth(face: _Face, rng: np.random.Generator, talking: Floats, rounded: Floats) -> None:
    """Syllables; `rounded`: to what share lips are pursed where they would be."""
    names = sorted({name for target in (*CONSONANTS, *VOWELS, REST) for name in target})
    at, targets = [-1.0], [REST]
    effort = [1.0]
    while at[-1] <= face.times[-1]:
        length = 1.0 / rng.uniform(*SYLLABLES)
        start = at[-1] + 0.6 * length
        talks = talking[np.clip(round(start * face.rate), 0, face.frames - 1)] > 0.5
        consonant, vowel = CONSONANTS[rng.integers(len(CONSONANTS))], VOWELS[rng.integers(len(VOWELS))]
        at += [start, start + 0.4 * length]
        targets += [consonant, vowel] if talks else [REST, REST]
        effort += [rng.uniform(0.8, 1.2), rng.uniform(0.5, 1.2)]
    full = np.array([[target.get(name, 0.0) for name in names] for target in targets])
    values = full * np.array(effort)[:, None]
    for name, column in zip(names, values.T, strict=True):
        moved = face.smooth(np.interp(face.times, at, column), COARTICULATION)
        face.add(name, moved * rounded if name in ROUNDED else moved)


def _mood(face: _Face, talking: Floats, smile: Floats) -> None:
    """Smile or frown, and what goes with it; the mouth and jaw to a side."""
    loose = (1.0 - 0.4 * face.smooth(talking, 0.2)) * (1.0 - 0.8 * face.values["mouthPucker"])
    mood = 0.05 + face.wander(2.0, 0.3)
    lifted = np.maximum(mood, 0.0) * (1.0 - smile) + np.minimum(mood, 0.0) * np.maximum(1.0 - 2.0 * smile, 0.0)
    face.split("mouthSmile", "mouthFrown", loose * lifted + smile)
    mood = lifted + smile
    face.add("cheekSquint", 0.5 * np.maximum(mood, 0.0))
    face.add("eyeSquint", 0.25 * np.maximum(mood, 0.0) + 0.1 * np.maximum(face.wander(1.5, 1.0), 0.0))
    face.add("mouthDimple", 0.2 * np.maximum(mood, 0.0))
    face.add("mouthShrugUpper", 0.2 * np.maximum(-mood, 0.0))
    face.add("cheekPuff", 0.06 * np.maximum(face.wander(1.0, 1.0), 0.0))
    face.add("jawForward", 0.04 * np.maximum(face.wander(1.0, 1.0), 0.0))
    face.split("jawLeft", "jawRight", face.wander(0.6, 0.04))
    face.split("mouthLeft", "mouthRight", face.wander(0.8, 0.07))


def _brows_and_nose(face: _Face, talking: Floats) -> None:
    """Raised or drawn together, livelier when talking."""
    brows = face.wander(1.2, 0.25) + face.smooth(talking, 0.2) * face.wander(0.3, 0.15)
    face.add("browInnerUp", np.maximum(brows + 0.05, 0.0))
    face.split("browOuterUp", "browDown", brows)
    face.add("noseSneer", 0.3 * np.maximum(-brows, 0.0) + 0.05 * np.maximum(face.wander(0.8, 1.0), 0.0))


def _eyes(face: _Face, rng: np.random.Generator) -> None:
    """Gaze that jumps and rests, lids that follow it, and blinks."""
    up, left = _gaze(face, rng, 0.14), _gaze(face, rng, 0.16)
    up -= 0.1
    for side, outward in (("Left", left), ("Right", -left)):
        face.split(f"eyeLookOut{side}", f"eyeLookIn{side}", outward)
        face.split(f"eyeLookUp{side}", f"eyeLookDown{side}", up)
    closed = _blinks(face, rng)
    face.add("eyeBlink", LIDS_FOLLOW * np.maximum(-up, 0.0))
    for lids in ("eyeBlinkLeft", "eyeBlinkRight"):
        face.values[lids] = closed + (1.0 - closed) * face.values[lids]
    brows = face.values["browInnerUp"]
    face.add("eyeWide", (0.4 * np.maximum(brows - 0.15, 0.0) + 0.2 * np.maximum(up, 0.0)) * (1.0 - closed))


def _gaze(face: _Face, rng: np.random.Generator, deviation: float) -> Floats:
    """Fixations of 0.3 to 2 s, and saccades of about 50 ms between them."""
    count = int(face.times[-1] / 0.3) + 2
    until = np.cumsum(rng.uniform(0.3, 2.0, count))
    points = rng.normal(0.0, deviation, count) * np.where(rng.random(count) < GLANCES, GLANCE, 1.0)
    held = points[np.searchsorted(until, face.times, side="right").clip(max=count - 1)]
    return face.smooth(held, 0.02)


def _blinks(face: _Face, rng: np.random.Generator) -> Floats:
    """How far the lids are closed by blinks, shape (frames,): down, closed for a frame or more, and slowly up."""
    times, closed = face.times, np.zeros(face.frames)
    shortest = min(1.01 / (HELD * face.rate), BLINK_LASTS[1])
    length = max(rng.uniform(*BLINK_LASTS), shortest)
    start, depth = rng.uniform(0.0, max(min(times[-1], BLINK_EVERY[1]) - length, 0.0)), 1.0
    while start <= times[-1]:
        phase = (times - start) / length
        part = np.clip(np.minimum(phase / FALL, (1.0 - phase) / (1.0 - FALL - HELD)), 0.0, 1.0)
        closed = np.maximum(closed, depth * part * part * (3.0 - 2.0 * part))
        start += length + rng.uniform(*BLINK_EVERY)
        length = max(rng.uniform(*BLINK_LASTS), shortest)
        depth = 1.0 if rng.random() < CLOSED_SHARE else rng.uniform(*PARTLY)
    return closed
