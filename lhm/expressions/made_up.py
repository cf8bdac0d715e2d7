"""Made-up takes, for training where no recordings are at hand: random expressions, conversation, head motion, speech.

In a conversation, turns of talk and of listening follow one another. In talk, 3 to 6 syllables per second each draw the
mouth to a consonant and then to a vowel; smoothing over 35 ms lets neighbours colour one another (coarticulation).
Mood, brows and sideways motion are Ornstein-Uhlenbeck processes whose sign chooses the expression, so that of a
contradictory pair (left or right, smile or frown) one is always zero. Now and then mood rises to a broad smile, during
which the lips are less rounded. Eyes fixate, mostly ahead and sometimes far aside, and lids follow them down; most
blinks close the lids. A conversation of 2 s or more holds a blink that closes them in at least one frame, and a broad
smile; a shorter one has them where there is room. The figures are chosen by us, to have the range and speed of a
recorded take.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
import scipy
from scipy.ndimage import gaussian_filter1d

from ..base.errors import InputError, MissingDependencyError, quote
from ..base.limits import SPEECH_LETTERS
from ..base.mesh import Floats
from ..identities.arkit import ARKIT, index
from .readers import read_livelink
from .takes import Take, check_frames, check_rate

_COLUMN = {name: column for column, name in enumerate(ARKIT)}

UNITS: tuple[tuple[str, ...], ...] = (
    *(
        (f"{name}Left", f"{name}Right")
        for name in (
            "browDown browOuterUp cheekSquint eyeBlink eyeLookDown eyeLookUp eyeSquint eyeWide mouthDimple mouthFrown "
            "mouthLowerDown mouthPress mouthSmile mouthStretch mouthUpperUp noseSneer"
        ).split()
    ),
    ("eyeLookOutLeft", "eyeLookInRight"),
    ("eyeLookInLeft", "eyeLookOutRight"),
    *(
        (name,)
        for name in (
            "browInnerUp cheekPuff jawForward jawLeft jawRight mouthClose mouthFunnel mouthLeft mouthPucker mouthRight "
            "mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper tongueOut"
        ).split()
    ),
)
"""Units that are drawn as one: a symmetric pair, the two eyes looking to one side, or a shape of its own."""

CONTRADICTORY = (
    ("browDown", "browOuterUp"),
    ("browDown", "browInnerUp"),
    ("eyeBlink", "eyeWide"),
    ("eyeSquint", "eyeWide"),
    ("eyeLookDown", "eyeLookUp"),
    ("eyeLookOutLeft", "eyeLookInLeft"),
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    ("mouthSmile", "mouthFrown"),
    ("mouthSmile", "mouthPucker"),
    ("mouthSmile", "mouthFunnel"),
    ("mouthStretch", "mouthPucker"),
    ("mouthStretch", "mouthFunnel"),
    ("mouthPucker", "mouthFunnel"),
    ("mouthPress", "mouthFunnel"),
    ("mouthPress", "mouthLowerDown"),
    ("mouthPress", "mouthUpperUp"),
    ("mouthRollLower", "mouthLowerDown"),
    ("mouthRollLower", "mouthFunnel"),
    ("mouthRollUpper", "mouthUpperUp"),
    ("mouthRollUpper", "mouthFunnel"),
)
"""Pairs, by how their names begin, that one face does not show at once."""


@dataclass(frozen=True)
class ExpressionPolicy:
    """Constants of random expressions, and of the way from one to the next; spans of durations in [s]."""

    jaw_share: float = 0.6  # of expressions with an open jaw
    symmetric_share: float = 0.8  # of pairs
    more_units: float = 2.0  # beside the first, in the mean
    moved: tuple[float, float] = (0.15, 0.6)
    holds: tuple[float, float] = (0.1, 0.4)
    meet: float = 0.3  # share of a fall in which the next begins to rise
    hard_shapes: tuple[int, int] = (2, 5)
    hard_ranges: tuple[tuple[float, float], tuple[float, float]] = (
        (0.2, 1.0),
        (0.1, 0.5),
    )  # of weights, in either half


EXPRESSIONS = ExpressionPolicy()
# Mouth targets at full effort; names without a side stand for both sides.
CONSONANTS: tuple[dict[str, float], ...] = (
    {"jawOpen": 0.25, "mouthClose": 0.25, "mouthPress": 0.3, "mouthRollUpper": 0.2, "mouthRollLower": 0.25},  # m b p
    {"jawOpen": 0.15, "mouthClose": 0.15, "mouthPress": 0.25, "cheekPuff": 0.2, "mouthPucker": 0.15},  # p, plosive
    {"jawOpen": 0.1, "mouthRollLower": 0.35, "mouthUpperUp": 0.2, "mouthShrugLower": 0.2},  # f v
    {"jawOpen": 0.18, "mouthUpperUp": 0.15, "mouthLowerDown": 0.25, "mouthStretch": 0.2},  # t d n
    {"jawOpen": 0.2, "mouthLowerDown": 0.3, "mouthUpperUp": 0.15},  # l th
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


@dataclass(frozen=True)
class TalkPolicy:
    """The habits of a talker, chosen to have the range and speed of a recorded take; spans of durations in [s]."""

    syllables: tuple[float, float] = (3.0, 6.0)  # [1/s]
    talk: tuple[float, float] = (2.0, 7.0)
    listen: tuple[float, float] = (0.8, 4.0)
    coarticulation: float = 0.035  # [s]
    uneven: float = 0.08  # by how much the two sides differ
    blink_every: tuple[float, float] = (2.0, 6.0)
    blink_lasts: tuple[float, float] = (0.12, 0.4)
    fall: float = 0.3  # share of a blink: lids going down
    held: float = 0.2  # and staying closed
    closed_share: float = 0.8  # of the blinks
    partly: tuple[float, float] = (0.6, 0.95)  # how far the others go
    smile_every: tuple[float, float] = (6.0, 16.0)
    smile_lasts: tuple[float, float] = (1.0, 3.5)
    smile_rises: tuple[float, float] = (0.25, 0.5)
    broad: tuple[float, float] = (0.75, 1.0)
    glances: float = 0.2  # share of fixations far aside
    glance: float = 2.5  # and how much farther they are
    lids_follow: float = 0.4  # eyeBlink per eyeLookDown; 0.67 over a recorded take, whose lids also close else
    posture: tuple[float, float, float] = (7.0, 4.0, 3.0)  # deviation of yaw, pitch and roll [degrees]
    beats: tuple[float, float, float] = (1.2, 2.0, 0.8)
    slow: float = 0.5  # time constant [s] of posture
    quick: float = 0.07  # and of beats
    passes: int = 4  # low passes, so that the angular acceleration is continuous


TALKER = TalkPolicy()
PACE = 12.0
"""Sounds per second of unhurried talk; 18 is fast."""
SLOWEST, FASTEST = 2.0, 30.0
SILENCE, COMMA, STOP = 0.2, 0.2, 0.4
"""Silence [s] at both ends, within a sentence and between sentences."""
GESTURES = {
    "blink_L": (("eyeBlinkLeft", 1.0),),
    "blink_R": (("eyeBlinkRight", 1.0),),
}


def sample_weights(rng: np.random.Generator) -> Floats:
    """Draw one random expression: ARKit weights in [0, 1], shape (52,).

    The jaw opens in 60 % of all; one unit is active, and a Poisson number of mean 2 beside it; a pair is symmetric to
    10 % in 80 % of cases and one-sided otherwise. mouthClose, which means closing an open jaw, never exceeds jawOpen.
    """
    weights = np.zeros(len(ARKIT))
    if rng.random() < EXPRESSIONS.jaw_share:
        weights[index("jawOpen")] = rng.uniform(0.05, 1.0)
    active: list[str] = []
    for number in rng.permutation(len(UNITS))[: 1 + rng.poisson(EXPRESSIONS.more_units)]:
        unit = UNITS[number]
        amplitude, sides = rng.uniform(0.1, 1.0), rng.random()
        spread = rng.uniform(0.9, 1.0, len(unit))
        if len(unit) == 2 and sides > EXPRESSIONS.symmetric_share and not unit[0].startswith("eyeLook"):
            unit, spread = (unit[int(sides * 1000) % 2],), spread[:1]
        if any(contradict(name, other) for name in unit for other in active):
            continue
        active.extend(unit)
        for name, factor in zip(unit, spread, strict=True):
            weights[index(name)] = amplitude * factor
    weights[index("mouthClose")] = min(weights[index("mouthClose")], weights[index("jawOpen")])
    # mouthClose alone leaves nothing, which is no expression: draw again.
    return weights if weights.any() else sample_weights(rng)


def combinations(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Floats:
    """Make up weights that go from one random expression to another, shape (frames, 52), in [0, 1], `rate` [Hz].

    Each is reached in 0.15 to 0.6 s, smoothly, as the one before has mostly gone, so that of two that contradict each
    other one is below 0.15; it is held for 0.1 to 0.4 s. Raises InputError for fewer than one frame and a rate that is
    not positive.
    """
    check_frames(frames, rate)
    times, weights = np.arange(frames) / rate, np.zeros((frames, len(ARKIT)))
    start, expression = 0.0, sample_weights(rng)
    while start <= times[-1]:
        rises, held, falls = (
            rng.uniform(*EXPRESSIONS.moved),
            rng.uniform(*EXPRESSIONS.holds),
            rng.uniform(*EXPRESSIONS.moved),
        )
        there, end = start + rises, start + rises + held + falls
        part = np.clip(np.minimum((times - start) / rises, (end - times) / falls), 0.0, 1.0)
        weights = np.maximum(weights, (part * part * (3.0 - 2.0 * part))[:, None] * expression)
        start, expression = there + held + (1.0 - EXPRESSIONS.meet) * falls, sample_weights(rng)
    weights[:, index("mouthClose")] = np.minimum(weights[:, index("mouthClose")], weights[:, index("jawOpen")])
    return weights


def hard_expressions(rng: np.random.Generator, frames: int) -> Floats:
    """Draw weights without order in time, shape (frames, 52), in [0, 1]: two to five random shapes at once, one-sided.

    Half of the frames have weights of 0.2 to 1, half of 0.1 to 0.5. No two shapes contradict each other, and
    mouthClose never exceeds jawOpen. Raises InputError for fewer than one frame.
    """
    check_frames(frames, 1.0)
    weights = np.zeros((frames, len(ARKIT)))
    shut, opened = _COLUMN["mouthClose"], _COLUMN["jawOpen"]
    for row in weights:
        while not row.any():
            count, span = (
                rng.integers(EXPRESSIONS.hard_shapes[0], EXPRESSIONS.hard_shapes[1] + 1),
                EXPRESSIONS.hard_ranges[rng.integers(2)],
            )
            active: list[str] = []
            for name in rng.permutation(ARKIT):
                if len(active) < count and not any(contradict(name, other) for other in active):
                    active.append(str(name))
                    row[_COLUMN[name]] = rng.uniform(*span)
            row[shut] = min(row[shut], row[opened])
    return weights


@cache
def contradict(a: str, b: str) -> bool:
    """Whether two ARKit shapes are kept apart."""
    return any(
        (a.startswith(first) and b.startswith(second)) or (b.startswith(first) and a.startswith(second))
        for first, second in CONTRADICTORY
    )


def conversation(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Floats:
    """Make up weights like those of a conversation, in ARKit's order, shape (frames, 52), in [0, 1], `rate` [Hz].

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


def conversation_take(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Take:
    """Make up a conversation as a take at `rate` [Hz] whose head moves as a talker's (see `head_motion`)."""
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
            self.values[name + side] = self.values[name + side] + values * (1.0 + self.wander(3.0, TALKER.uneven))

    def split(self, name: str, opposite: str, signed: Floats) -> None:
        """Add positive values to one expression and negative ones to its opposite."""
        self.add(name, np.maximum(signed, 0.0))
        self.add(opposite, np.maximum(-signed, 0.0))

    def wander(self, seconds: float, deviation: float) -> Floats:
        """A stationary Ornstein-Uhlenbeck process around 0 with this correlation time, smoothed, shape (frames,)."""
        keep = float(np.exp(-1.0 / (seconds * self.rate)))
        noise = self.rng.standard_normal(self.frames + 1) * np.sqrt(1.0 - keep**2)
        walk = scipy.signal.lfilter([1.0], [1.0, -keep], noise[1:], zi=[keep * noise[0] / np.sqrt(1.0 - keep**2)])[0]
        return deviation * self.smooth(walk, min(0.1 * seconds, 0.1))

    def smooth(self, values: Floats, seconds: float) -> Floats:
        """Average over a Gaussian of this deviation [s]."""
        return gaussian_filter1d(values, seconds * self.rate, axis=0, mode="nearest")

    def weights(self) -> Floats:
        """Give all in ARKit's order, in [0, 1], shape (frames, 52)."""
        self.values["mouthClose"] = np.minimum(self.values["mouthClose"], self.values["jawOpen"])
        return np.clip(np.stack([self.values[name] for name in ARKIT], axis=1), 0.0, 1.0)


def _turns(rng: np.random.Generator, times: Floats) -> Floats:
    """1 where this face talks and 0 where it listens, shape (frames,)."""
    starts, talks = [-rng.uniform(*TALKER.talk)], rng.random() < 0.5
    states = [talks]
    while starts[-1] <= times[-1]:
        starts.append(starts[-1] + rng.uniform(*(TALKER.talk if states[-1] else TALKER.listen)))
        states.append(not states[-1])
    return np.array(states, dtype=np.float64)[np.searchsorted(starts, times, side="right") - 1]


def _smiles(face: _Face, rng: np.random.Generator) -> Floats:
    """Make the smile's breadth, shape (frames,): zero but for some seconds now and then, first within `smile_every`."""
    broad = np.zeros(face.frames)
    until = float(face.times[-1])
    length = min(rng.uniform(*TALKER.smile_lasts), max(0.75 * until, 1.0 / face.rate))
    start = rng.uniform(0.0, max(min(until, TALKER.smile_every[1]) - length, 0.0))
    while start <= until:
        rise = min(rng.uniform(*TALKER.smile_rises), 0.4 * length)
        part = np.clip(np.minimum(face.times - start, start + length - face.times) / rise, 0.0, 1.0)
        broad = np.maximum(broad, rng.uniform(*TALKER.broad) * part * part * (3.0 - 2.0 * part))
        start += length + rng.uniform(*TALKER.smile_every)
        length = rng.uniform(*TALKER.smile_lasts)
    return broad


def _mouth(face: _Face, rng: np.random.Generator, talking: Floats, rounded: Floats) -> None:
    """Syllables; `rounded`: to what share lips are pursed where they would be."""
    names = sorted({name for target in (*CONSONANTS, *VOWELS, REST) for name in target})
    moments, targets = [-1.0], [REST]
    effort = [1.0]
    while moments[-1] <= face.times[-1]:
        length = 1.0 / rng.uniform(*TALKER.syllables)
        start = moments[-1] + 0.6 * length
        talks = talking[np.clip(round(start * face.rate), 0, face.frames - 1)] > 0.5
        consonant, vowel = CONSONANTS[rng.integers(len(CONSONANTS))], VOWELS[rng.integers(len(VOWELS))]
        moments += [start, start + 0.4 * length]
        targets += [consonant, vowel] if talks else [REST, REST]
        effort += [rng.uniform(0.8, 1.2), rng.uniform(0.5, 1.2)]
    full = np.array([[target.get(name, 0.0) for name in names] for target in targets])
    values = full * np.array(effort)[:, None]
    for name, column in zip(names, values.T, strict=True):
        smoothed = face.smooth(np.interp(face.times, moments, column), TALKER.coarticulation)
        face.add(name, smoothed * rounded if name in ROUNDED else smoothed)


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
    face.add("eyeBlink", TALKER.lids_follow * np.maximum(-up, 0.0))
    for lids in ("eyeBlinkLeft", "eyeBlinkRight"):
        face.values[lids] = closed + (1.0 - closed) * face.values[lids]
    brows = face.values["browInnerUp"]
    face.add("eyeWide", (0.4 * np.maximum(brows - 0.15, 0.0) + 0.2 * np.maximum(up, 0.0)) * (1.0 - closed))


def _gaze(face: _Face, rng: np.random.Generator, deviation: float) -> Floats:
    """Fixations of 0.3 to 2 s, and saccades of about 50 ms between them."""
    count = int(face.times[-1] / 0.3) + 2
    until = np.cumsum(rng.uniform(0.3, 2.0, count))
    points = rng.normal(0.0, deviation, count) * np.where(rng.random(count) < TALKER.glances, TALKER.glance, 1.0)
    gaze = points[np.searchsorted(until, face.times, side="right").clip(max=count - 1)]
    return face.smooth(gaze, 0.02)


def _blinks(face: _Face, rng: np.random.Generator) -> Floats:
    """Close the lids by blinks, a share of shape (frames,): down, closed for a frame or more, and slowly up."""
    times, closed = face.times, np.zeros(face.frames)
    shortest = min(1.01 / (TALKER.held * face.rate), TALKER.blink_lasts[1])
    length = max(rng.uniform(*TALKER.blink_lasts), shortest)
    start, depth = rng.uniform(0.0, max(min(times[-1], TALKER.blink_every[1]) - length, 0.0)), 1.0
    while start <= times[-1]:
        phase = (times - start) / length
        part = np.clip(np.minimum(phase / TALKER.fall, (1.0 - phase) / (1.0 - TALKER.fall - TALKER.held)), 0.0, 1.0)
        closed = np.maximum(closed, depth * part * part * (3.0 - 2.0 * part))
        start += length + rng.uniform(*TALKER.blink_every)
        length = max(rng.uniform(*TALKER.blink_lasts), shortest)
        depth = 1.0 if rng.random() < TALKER.closed_share else rng.uniform(*TALKER.partly)
    return closed


def head_motion(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Floats:
    """Make up the yaw, pitch and roll [rad] (see `rotations`) of a head that talks, shape (frames, 3), `rate` [Hz].

    Posture drifts over seconds about straight ahead; on it small beats follow one another as stressed syllables or nods
    do. Both are noise through low passes, so that the angular acceleration is continuous as that of a real head: what
    shakes flesh is an acceleration. The figures are chosen by us.

    The same generator state gives the same angles. Raises InputError for fewer than one frame and a rate that is not
    positive.
    """
    if frames < 1:
        raise InputError(f"frames: {frames}, expected 1 or more")
    check_rate(rate)
    return _sway(rng, frames, TALKER.slow * rate) * np.radians(TALKER.posture) + _sway(
        rng, frames, TALKER.quick * rate
    ) * np.radians(TALKER.beats)


def _sway(rng: np.random.Generator, frames: int, constant: float) -> Floats:
    """Noise through equal low passes of a time constant in frames: variance 1 from the first on, shape (frames, 3)."""
    pole = float(np.exp(-1.0 / constant))
    poles = np.poly([pole] * TALKER.passes)
    ahead = int(np.ceil(15.0 * constant)) + 1
    answer = scipy.signal.lfilter([1.0], poles, np.eye(1, ahead)[0])
    noise = rng.standard_normal((ahead + frames, 3))
    return scipy.signal.lfilter([1.0], poles, noise, axis=0)[ahead:] / np.linalg.norm(answer)


def speech(text: str, *, pace: float = PACE) -> Take:
    """Make up a take of someone saying an English text, at 60 Hz, by openfacefx (MIT).

    The same text and pace [sounds per second] give the same. Nobody has spoken it: sounds last as long as such sounds
    do (openfacefx's priors), and pauses stand where the text has punctuation. Beside the mouth the lids blink; brows,
    gaze and head rest.

    Raises InputError for a text without words or with one that has no sounds, such as 3, for one that is longer than
    `limits.SPEECH_LETTERS`, and for a pace outside [2, 30]; MissingDependencyError without openfacefx.
    """
    SPEECH_LETTERS.check("speech", len(text))
    if not SLOWEST <= pace <= FASTEST:
        raise InputError(f"pace: {pace:g} sounds per second, expected {SLOWEST:g} to {FASTEST:g}")
    try:
        import openfacefx as fx
        from openfacefx.retarget import PRESETS, retarget
    except ImportError:
        raise MissingDependencyError("speech needs the package openfacefx: pip install 'softdeca[speech]'") from None
    segments = _segments(text, 1.0 / pace)
    track = fx.generate_from_alignment(segments, gestures=fx.GestureParams(seed=zlib.crc32(text.encode())))
    csv, _ = fx.livelink_csv_string(retarget(track, PRESETS["arkit"] | GESTURES))
    take = read_livelink(csv)
    weights = take.weights.copy()
    weights[:, index("tongueOut")] = 0.0  # no head here has a tongue
    return Take(weights, take.rate, take.times, synthetic="speech by openfacefx")


def _segments(text: str, seconds: float) -> list:
    """The sounds and silences of a text, a sound lasting `seconds` in the mean."""
    import openfacefx as fx

    sounds_of, aligner = fx.G2P(), fx.NaiveAligner()
    segments = [fx.PhonemeSegment("sil", 0.0, SILENCE)]
    for words, mark in re.findall(r"([^.,;:!?…]+)([.,;:!?…]*)", text):
        sounds = [sound for word in words.split() for sound in _spoken(word, sounds_of)]
        if not sounds:
            continue
        segments += aligner.align(sounds, len(sounds) * seconds, segments[-1].end)
        pause = STOP if re.search(r"[.!?…]", mark) else COMMA
        segments.append(fx.PhonemeSegment("sil", segments[-1].end, segments[-1].end + pause))
    if len(segments) == 1:
        raise InputError(f"speech: no words in {quote(text)!r}")
    return segments


def _spoken(word: str, sounds_of) -> list[str]:
    sounds = sounds_of.phrase(word)
    if not sounds and re.search(r"\w", word):
        raise InputError(f"speech: {quote(word)!r} is no English word; numbers are to be written out")
    return sounds


def shipped_sentences() -> tuple[str, ...]:
    """Read the sentences to be spoken, each of some seconds, with every sound of English and many closed lips."""
    lines = resources.files(__package__).joinpath("speech.txt").read_text(encoding="utf-8").splitlines()
    return tuple(line for line in lines if line.strip())
