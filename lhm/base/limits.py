"""The largest counts and sizes that are accepted from files and arguments: one name, one number and one reason each.

`docs/bounds.md` is made of this table. A bound lies far above every real use and below what exhausts a small machine.
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from typing import Any

from .errors import InputError, quote


@dataclass(frozen=True)
class Bound:
    """A count of `what` lies within least..most, for `reason`."""

    what: str
    most: int
    reason: str
    least: int = 0

    def check(self, name: str, count: Any) -> int:
        """Return a count as int; InputError names it for another kind of value, or one outside the bound."""
        if not isinstance(count, numbers.Integral) or isinstance(count, bool):
            shown = repr(count) if isinstance(count, str) and len(count) < 40 and count.isprintable() else quote(count)
            raise InputError(f"{name}: expected a whole number, got {shown}")
        if not self.least <= int(count) <= self.most:
            allowed = f"{self.least:,} to {self.most:,}" if self.least or count < 0 else f"at most {self.most:,}"
            raise InputError(f"{name}: {quote(count)} {self.what}; expected {allowed}")
        return int(count)


# Files of every kind.
FILE_BYTES = Bound("bytes", 1_000_000_000, "the largest scans have some 300 MB; reading needs up to ten times the size")
UNPACKED_BYTES = Bound("bytes unpacked", 2_000_000_000, "a template of level 3 unpacks to 0.2 GB; more is a zip bomb")
JSON_BYTES = Bound("bytes of JSON", 200_000_000, "an hour's take at 60 Hz has 100 MB; Python needs ten times its size")

# Meshes, heads and templates.
VERTICES = Bound("vertices", 20_000_000, "the densest scans have some 10 million")
MORPH_VALUES = Bound("numbers in morph targets", 250_000_000, "2 GB: 400 targets of 200,000 vertices")
PIXELS = Bound("pixels", 80_000_000, "the largest textures have 8,192 by 8,192; decoded they take 4 bytes each")

# Takes, corpora, weights, results of studies, and counts of commands.
TOML_BYTES = Bound("bytes of TOML", 100_000, "a file of options has some hundred; arrays stand in files of their own")
TAKE_BYTES = Bound("bytes of a take", 200_000_000, "an hour at 60 Hz has 100 MB; Python needs ten times its size")
TAKE_FRAMES = Bound("frames", 1_000_000, "four hours at 60 Hz, and 0.4 GB; made up they need four times that", 1)
SPEECH_LETTERS = Bound("letters", 5_000, "five minutes; the work grows with the square, 140 s for 20,000 letters")
RECORDINGS = Bound("recordings", 10_000, "the plan `paper` has 400 of a kind")
RECORDED_FILES = Bound("files of takes", 10_000, "each is read and resampled before anything begins")
MARCH_STEPS = Bound("steps", 1_000_000, "a step takes 0.1 s or more: a day of work", 1)
SEED = Bound("as a seed", 2**63 - 1, "64 bits")
PEOPLE = Bound("people", 99_999, "names of shards have five digits; the plan `paper` has 7,813 people", 2)
PARAMETER_SETS = Bound("parameter sets", 1_000_000, "all are permuted for each person; `paper` has 31,252", 1)
PERSON_FRAMES = Bound("frames of one person", 20_000, "a shard is held in memory: 0.6 GB; `paper` has 48")
PERSON_SEQUENCES = Bound("sequences of one person", 1_000, "a shard is held in memory: 0.5 GB; `paper` has one")
RUN_FRAMES = Bound("frames of the run", 100_000, "the plans have 1,024; a frame is 0.1 s of work and 30 kB", 3)
ITERATIONS = Bound("iterations", 1_000_000, "a solve of 1,000 iterations has failed", 1)
SHARD_BYTES = Bound("bytes of a shard", 2_000_000_000, "a person of `small` has 7 MB; a shard is held in memory")
WEIGHTS_BYTES = Bound("bytes of weights", 1_000_000_000, "the shipped network has 29 MB; weights are held in memory")
TRAINING_STEPS = Bound("steps", 100_000_000, "a step takes a millisecond or more: a day of work", 1)
WORKERS = Bound("processes", 256, "each takes 0.2 GB or more, whatever the machine has", 1)
LEVEL = Bound("as a level", 3, "templates have three", 1)
STUDIED_PEOPLE = Bound("people of a study", 1_000, "each is minutes of work", 1)
STUDIED_HEADS = Bound("heads of a study", 100_000, "each is a second of work or more", 1)
UNKNOWNS = Bound("unknowns", 100_000_000, "a machine of 64 GB holds some ten million", 1)
RESULT_BYTES = Bound("bytes of results", 100_000_000, "the largest study writes 2 MB")

# The live viewer.
PORT = Bound("as a port", 65_535, "below 1,024 only root may listen", 1_024)
TABS = Bound("tabs", 4, "each refines in a process of its own, of some 0.7 GB", 1)
CHANGE_BYTES = Bound("bytes of a change", 16_384, "52 weights and all parameters have 3,000")
CHANGES_PER_SECOND = Bound("changes in a second", 240, "a page sends one for each redraw, 60 to 144 in a second")
