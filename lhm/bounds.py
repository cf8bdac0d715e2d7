"""The largest counts and sizes that are accepted from files and arguments: one name, one number and one reason each.

`docs/bounds.md` is made of this table. A bound lies far above every real use and below what exhausts a small machine.
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from typing import Any

from .errors import InputError


@dataclass(frozen=True)
class Bound:
    """A count of `what` lies within least..most, for `reason`."""

    what: str
    most: int
    reason: str
    least: int = 0

    def check(self, name: str, count: Any) -> int:
        """Return a count as int; InputError names it for another kind of value, or one outside the bound."""
        good = isinstance(count, numbers.Integral) and not isinstance(count, bool)
        if not good or not self.least <= int(count) <= self.most:
            allowed = f"{self.least:,} to {self.most:,}" if self.least else f"at most {self.most:,}"
            raise InputError(f"{name}: {shown(count)} {self.what}; expected {allowed}")
        return int(count)


def shown(value: Any, longest: int = 40) -> str:
    """Quote a value in an error: one line of printable characters, at most `longest` of them and three dots."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        # Python refuses to print an integer of more than 4,300 digits.
        return f"{int(value):,}" if abs(int(value)) < 10**18 else "more than 10^18" if value > 0 else "less than -10^18"
    text = plain(value if isinstance(value, str) else repr(value))
    return text if len(text) <= longest else text[:longest] + "..."


def plain(text: str) -> str:
    """Escape what is no printable character, so that a text from a file cannot steer the terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


FILE_BYTES = Bound(
    "bytes", 2_000_000_000, "the largest scans have 1 GB; a reader needs some five times the file's size"
)
UNPACKED_BYTES = Bound("bytes unpacked", 2_000_000_000, "a template of level 3 unpacks to 0.2 GB; more is a zip bomb")
JSON_BYTES = Bound("bytes of JSON", 200_000_000, "an hour's take at 60 Hz has 100 MB; Python needs ten times its size")
JSON_DEPTH = Bound("levels of brackets", 64, "no format that is read nests more than ten levels")
JSON_DIGITS = Bound("digits in an integer", 18, "18 digits fit 64 bits; no index, count or time needs more")

# Takes, corpora, weights, results of studies, and counts of commands.
TOML_BYTES = Bound("bytes of TOML", 100_000, "a file of options has some hundred; arrays stand in files of their own")
TAKE_BYTES = Bound("bytes of a take", 200_000_000, "an hour at 60 Hz has 100 MB; Python needs ten times its size")
TAKE_FRAMES = Bound("frames", 1_000_000, "four hours at 60 Hz, and 0.4 GB; made up they need four times that", 1)
SPEECH_LETTERS = Bound("letters", 5_000, "five minutes; the work grows with the square, 140 s for 20,000 letters")
RECORDINGS = Bound("recordings", 10_000, "the plan `paper` has 400 of a kind")
RECORDED_FILES = Bound("files of takes", 10_000, "each is read and resampled before anything begins")
MARCH_STEPS = Bound("steps", 1_000_000, "a step takes 0.1 s or more: a day of work", 1)
MARCH_VALUES = Bound("recorded numbers", 250_000_000, "a march keeps two 64-bit numbers for each; 4 GB in all")
SEED = Bound("as a seed", 2**63 - 1, "64 bits")
PEOPLE = Bound("people", 99_999, "names of shards have five digits; the plan `paper` has 7,813 people", 2)
PARAMETER_SETS = Bound("parameter sets", 1_000_000, "all are permuted for each person; `paper` has 31,252", 1)
PERSON_FRAMES = Bound("frames of one person", 20_000, "a shard is held in memory: 0.6 GB; `paper` has 48")
PERSON_SEQUENCES = Bound("sequences of one person", 1_000, "a shard is held in memory: 0.5 GB; `paper` has one")
RUN_FRAMES = Bound("frames of the run", 100_000, "the plans have 1,024; a frame is 0.1 s of work and 30 kB", 3)
ITERATIONS = Bound("iterations", 1_000_000, "a solve of 1,000 iterations has failed", 1)
SHARD_BYTES = Bound("bytes of a shard", 2_000_000_000, "a person of `small` has 7 MB; a shard is held in memory")
WEIGHTS_BYTES = Bound("bytes of weights", 1_000_000_000, "the shipped network has 10 MB; weights are held in memory")
CURVE_POINTS = Bound("points of a learning curve", 100_000, "a training notes some hundred")
TRAINING_STEPS = Bound("steps", 100_000_000, "a step takes a millisecond or more: a day of work", 1)
WORKERS = Bound("processes", 256, "each takes 0.2 GB or more, whatever the machine has", 1)
MORPH_TARGETS = Bound("morph targets", 4_096, "the network has some 150 directions; viewers stop far earlier", 1)
PAIRS = Bound("pairs of people", 10_000, "each pair is a minute of work", 1)
FACES = Bound("faces", 100_000, "each face is some seconds of work")
RESULT_BYTES = Bound("bytes of results", 100_000_000, "the largest study writes 2 MB")
