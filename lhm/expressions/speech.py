"""Speech from a text by openfacefx (MIT): phonemes, visemes with coarticulation, ARKit weights. Synthetic.

Nobody has spoken it: sounds last as long as such sounds do (openfacefx's priors), at a pace of our choosing, and pauses
stand where the text has punctuation. Beside the mouth the lids blink; brows, gaze and head rest.
"""

from __future__ import annotations

import re
import zlib
from importlib import resources

from ..base.checks import check_arguments
from ..base.errors import InputError, quote
from ..base.limits import SPEECH_LETTERS
from .livelink import parse_csv
from .take import Take

PACE = 12.0
"""Sounds per second of unhurried talk; 18 is fast."""
SLOWEST, FASTEST = 2.0, 30.0
REST, COMMA, STOP = 0.2, 0.2, 0.4
"""Silence [s] at both ends, within a sentence and between sentences."""
GESTURES = {
    "blink_L": (("eyeBlinkLeft", 1.0),),
    "blink_R": (("eyeBlinkRight", 1.0),),
}


@check_arguments
def speech(text: str, *, pace: float = PACE) -> Take:
    """A take of someone saying an English text, at 60 Hz; the same text and pace [sounds per second] give the same.

    Raises InputError for a text without words or with one that has no sounds, such as 3, for one that is longer than
    `limits.SPEECH_LETTERS`, for a pace outside [2, 30], and where openfacefx is not installed.
    """
    SPEECH_LETTERS.check("speech", len(text))
    if not SLOWEST <= pace <= FASTEST:
        raise InputError(f"pace: {pace:g} sounds per second, expected {SLOWEST:g} to {FASTEST:g}")
    try:
        import openfacefx as fx
        from openfacefx.retarget import PRESETS, retarget
    except ImportError:
        raise InputError("speech needs the package openfacefx: pip install 'softdeca[speech]'") from None
    segments = _segments(text, 1.0 / pace)
    track = fx.generate_from_alignment(segments, gestures=fx.GestureParams(seed=zlib.crc32(text.encode())))
    csv, _ = fx.livelink_csv_string(retarget(track, PRESETS["arkit"] | GESTURES))
    take = parse_csv(csv)
    return Take(take.weights, take.rate, take.times, synthetic="speech by openfacefx")


def _segments(text: str, seconds: float) -> list:
    """The sounds and silences of a text, a sound lasting `seconds` in the mean."""
    import openfacefx as fx

    sounds_of, aligner = fx.G2P(), fx.NaiveAligner()
    segments = [fx.PhonemeSegment("sil", 0.0, REST)]
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


def texts() -> tuple[str, ...]:
    """Sentences to be spoken, each of some seconds, with every sound of English and many closed lips."""
    lines = resources.files(__package__).joinpath("speech.txt").read_text(encoding="utf-8").splitlines()
    return tuple(line for line in lines if line.strip())
