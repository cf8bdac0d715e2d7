"""Apple's 52 face expressions: their names, spellings of other programs, and weights."""

from __future__ import annotations

import difflib
import re
import warnings
from collections.abc import Mapping

import numpy as np

from ..base.checks import array_of_kind
from ..base.errors import InputError, quote
from ..base.mesh import Floats

ARKIT = tuple(
    "browDownLeft browDownRight browInnerUp browOuterUpLeft browOuterUpRight cheekPuff cheekSquintLeft "
    "cheekSquintRight eyeBlinkLeft eyeBlinkRight eyeLookDownLeft eyeLookDownRight eyeLookInLeft eyeLookInRight "
    "eyeLookOutLeft eyeLookOutRight eyeLookUpLeft eyeLookUpRight eyeSquintLeft eyeSquintRight eyeWideLeft "
    "eyeWideRight jawForward jawLeft jawOpen jawRight mouthClose mouthDimpleLeft mouthDimpleRight mouthFrownLeft "
    "mouthFrownRight mouthFunnel mouthLeft mouthLowerDownLeft mouthLowerDownRight mouthPressLeft mouthPressRight "
    "mouthPucker mouthRight mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper mouthSmileLeft "
    "mouthSmileRight mouthStretchLeft mouthStretchRight mouthUpperUpLeft mouthUpperUpRight noseSneerLeft "
    "noseSneerRight tongueOut".split()
)
"""The names of Apple's 52 blendshapes, alphabetical: the order of every array of weights."""
_OPPOSITE = {"Left": "Right", "Right": "Left"}
MIRRORED = np.array([ARKIT.index(re.sub("Left$|Right$", lambda side: _OPPOSITE[side[0]], name)) for name in ARKIT])
"""The number of the expression that mirrors each, shape (52,): its own where both sides move."""

_SIDES = {"l": "left", "r": "right"}
_SIDE = re.compile(r"(?:[\s_.-][lrLR]|(?<=[a-z])[LR])$")
_PREFIX = re.compile(r"(?:[a-z]*\d+|bs|arkit|blendshape|face|head)[\s_-]+", re.IGNORECASE)
_KNOWN = {name.lower(): name for name in ARKIT}
_HALVED = {name.lower() for name in ("browInnerUp", "cheekPuff")}


def arkit_name(name: str) -> str | None:
    """Find the ARKit expression that another program's name stands for, or None.

    Letters' case, underscores, and L, R for Left, Right make no difference, nor does what stands before a dot or colon,
    or a number or a word such as face before an underscore. The halves of browInnerUp and cheekPuff, which some rigs
    have, stand for the whole.
    """
    return _name_and_half(name)[0]


def _name_and_half(name: str) -> tuple[str | None, str]:
    """Find the expression that a name stands for, or None, and "left" or "right" where it is half of one."""
    text = name.strip()
    if ending := _SIDE.search(text):
        text = text[: ending.start()] + _SIDES[text[-1].lower()]
    last = re.split(r"[.:|]", text)[-1]
    for spelling in (text, last, _PREFIX.sub("", last, count=1)):
        known = re.sub(r"[\s_.-]", "", spelling).lower()
        if known in _KNOWN:
            return _KNOWN[known], ""
        for side in _SIDES.values():
            if known.removesuffix(side) in _HALVED:
                return _KNOWN[known.removesuffix(side)], side
    return None, ""


def find_arkit_morphs(morphs: Mapping[str, Floats]) -> dict[str, Floats]:
    """Name morph targets (n, 3) by ARKit's names, halves added; unknown ones, and those that are zero, are left out.

    Targets of one name that move different vertices, as of face and teeth, are added too. Raises InputError for two
    that move the same.
    """
    named: dict[str, Floats] = {}
    before: dict[str, list[tuple[str, str]]] = {}
    for name, delta in morphs.items():
        known, half = _name_and_half(name)
        if known is None or not np.any(delta):
            continue
        for other, other_half in before.setdefault(known, []):
            halves = {half, other_half} == {"left", "right"}
            if not halves and np.any(np.logical_and(morphs[other], delta)):
                raise InputError(f"morph targets {quote(other)!r} and {quote(name)!r} are both {known}")
        before[known].append((name, half))
        named[known] = named[known] + delta if known in named else delta
    return named


def index(name: str) -> int:
    """Find the place of an expression in ARKIT; InputError names one that is unknown, and its near misses."""
    if name in ARKIT:
        return ARKIT.index(name)
    by_lower = {known.lower(): known for known in ARKIT}
    near = difflib.get_close_matches(name.lower(), by_lower, n=3)
    hint = f"; did you mean {' or '.join(by_lower[match] for match in near)}?" if near else ""
    raise InputError(f"unknown ARKit expression {quote(name)!r}{hint}")


def weights_of(named: Mapping[str, float]) -> Floats:
    """Make weights in ARKit's order, shape (52,), of the expressions named; the rest are zero.

    Raises InputError for a name that is unknown and a weight that is no number in [0, 1].
    """
    if not isinstance(named, Mapping):
        raise InputError(f"weights: expected names with numbers, as {{'jawOpen': 0.8}}, got {type(named).__name__}")
    weights = np.zeros(len(ARKIT))
    for name, weight in named.items():
        number = isinstance(weight, (int, float, np.number)) and not isinstance(weight, bool)
        if not (number and 0.0 <= weight <= 1.0):
            raise InputError(f"the weight of {quote(name)} is {quote(repr(weight))}, expected a number in [0, 1]")
        weights[index(name)] = weight
    return weights


def parse_weights(text: str) -> Floats:
    """Read weights (52,) of 'jawOpen*0.5+cheekPuff'; InputError names what cannot be read."""
    named: dict[str, float] = {}
    for part in text.split("+"):
        name, star, factor = (piece.strip() for piece in part.partition("*"))
        if not name:
            raise InputError(f"expression {text!r}: a name is missing; expected as 'jawOpen*0.5+cheekPuff'")
        try:
            weight = float(factor) if star else 1.0
        except ValueError:
            raise InputError(f"expression {text!r}: {factor!r} is no number") from None
        if not 0.0 <= weight <= 1.0:
            raise InputError(f"expression {text!r}: the weight of {name} is {weight:g}, outside [0, 1]")
        if name in named:
            raise InputError(f"expression {text!r}: {name} appears twice")
        named[name] = weight
    return weights_of(named)


def check_weights(weights) -> Floats:
    """Check weights of shape (..., 52); as float64, clipped to [0, 1] with a warning that counts those outside.

    Raises InputError for another shape, and for NaN or infinity (by frame and name).
    """
    words = f"numbers of shape (frames, {len(ARKIT)})"
    values = np.array(array_of_kind("weights", weights, "fiub", words), dtype=np.float64)
    if values.ndim not in (1, 2) or values.shape[-1] != len(ARKIT):
        raise InputError(f"weights: expected shape (frames, {len(ARKIT)}) or ({len(ARKIT)},), got {values.shape}")
    bad = np.argwhere(~np.isfinite(np.atleast_2d(values)))
    if len(bad):
        frame, shape = bad[0]
        raise InputError(f"weights: {len(bad)} are not finite, the first is {ARKIT[shape]} in frame {frame}")
    outside = int(np.count_nonzero((values < 0) | (values > 1)))
    if outside:
        warnings.warn(f"{outside} of {values.size} expression weights lay outside [0, 1]: clipped", stacklevel=3)
    return np.clip(values, 0.0, 1.0)
