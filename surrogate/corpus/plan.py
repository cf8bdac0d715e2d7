"""The content of a corpus, decided before anything is simulated: every sample follows from the plan alone."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ...lhm.base.checks import one_of
from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.text import read_toml
from ...lhm.base.limits import (
    ITERATIONS,
    PARAMETER_SETS,
    PEOPLE,
    PERSON_FRAMES,
    PERSON_SEQUENCES,
    RECORDINGS,
    RUN_FRAMES,
    SEED,
    Bound,
)
from ...lhm.base.mesh import Floats32
from ...lhm.expressions.recordings import Recording, recordings, starts
from ...lhm.expressions.takes import Take
from ...reference.face.tissue import CellKind
from .mixture import KINDS, ParameterSet, draw

Split = Literal["train", "test"]
SPLITS: tuple[Split, Split] = ("train", "test")
SOURCES = ("real", "speech", "conversation", "random", "hard")
STILL = ("hard",)
"""Sources whose frames have no order in time: no sequence is of them."""
TEST_SHARE = 0.1
RATE = 60.0
"""[Hz] of sequences."""
LENGTH = 16
"""Frames of a sequence (SoftDECA 3.4)."""
COUNTS: Mapping[str, Bound] = {
    "seed": SEED,
    "identities": PEOPLE,
    "groups": PARAMETER_SETS,
    "frames": PERSON_FRAMES,
    "sequences": PERSON_SEQUENCES,
    "references": PERSON_FRAMES,
    "conversations": RECORDINGS,
    "random": RECORDINGS,
    "hard": RECORDINGS,
    "run": RUN_FRAMES,
    "max_iterations": ITERATIONS,
}
"""The bound of each count of a plan."""
IDENTITY, PAIRING, PARAMETERS, SPLITTING, STATIC, DYNAMIC, VELOCITIES = range(7)


@dataclass(frozen=True)
class Static:
    """A planned static frame: a recording's name and the number of its frame."""

    recording: str
    frame: int


@dataclass(frozen=True)
class CorpusPlan:
    """Counts, shares and seed of a corpus.

    People, parameter sets and recordings are split into training and test first and paired then, so that the two splits
    share none of the three. Each person has `groups` parameter sets, no two people share one, and `frames` static
    frames of each; `sequences` of 16 frames at 60 Hz, the k-th under the person's k-th set. The share `responses` of
    all groups has derivatives by expressions. `references` static frames of each person in test are solved by FEniCSx,
    too; see `references`.

    `kinds` and `sources` are shares, of parameter sets (see `mixture`) and of expressions; sources without a recording
    leave theirs to the others. `takes`: folder of recorded takes. Sequences begin with velocities of one long run of
    `run` frames. `tolerance`: the norm of the gradient over that of springs each 1 mm long. `contact`: lids, lips and
    what lines them are kept from crossing. `cells`: what has one deformation each, see `facial_scene`. Raises
    InputError for counts and shares out of range.
    """

    seed: int = 0
    identities: int = 700
    groups: int = 3
    frames: int = 10
    sequences: int = 1
    responses: float = 1.0
    references: int = 0
    kinds: Mapping[str, float] = field(
        default_factory=lambda: {"materials": 0.34, "single": 0.16, "effects": 0.15, "both": 0.35}
    )
    varying: float = 0.5
    sources: Mapping[str, float] = field(
        default_factory=lambda: {"real": 0.15, "speech": 0.2, "conversation": 0.25, "random": 0.2, "hard": 0.2}
    )
    takes: str = ""
    conversations: int = 40
    random: int = 40
    hard: int = 40
    seconds: float = 60.0
    run: int = 1024
    tolerance: float = 5e-4
    max_iterations: int = 200
    inverted_share: float = 1e-3
    contact: bool = True
    cells: CellKind = "prisms"

    def __post_init__(self):
        for name, bound in COUNTS.items():
            bound.check(f"corpus plan {name}", getattr(self, name))
        PARAMETER_SETS.check("corpus plan identities * groups", self.identities * self.groups)
        PERSON_FRAMES.check("corpus plan groups * frames", self.groups * self.frames)
        if not isinstance(self.contact, bool):
            raise InputError(f"corpus plan contact: expected true or false, got {quote(self.contact)}")
        one_of("corpus plan cells", self.cells, get_args(CellKind))
        if not isinstance(self.takes, str):
            raise InputError(f"corpus plan takes: expected the name of a folder, got {quote(self.takes)}")
        if self.sequences > self.groups:
            raise InputError(f"corpus plan sequences: {self.sequences} for {self.groups} groups of a person")
        for name in ("responses", "varying", "inverted_share"):
            if not _is_share(getattr(self, name)):
                raise InputError(f"corpus plan {name}: expected a share in [0, 1], got {quote(getattr(self, name))}")
        for name, known in (("kinds", KINDS), ("sources", SOURCES)):
            object.__setattr__(self, name, _shares(name, getattr(self, name), known))
        if self.sequences and not any(share for source, share in self.sources.items() if source not in STILL):
            raise InputError(f"corpus plan sources: sequences need another source than {', '.join(STILL)}")
        if not (isinstance(self.tolerance, float) and 0.0 < self.tolerance < 1.0):
            raise InputError(f"corpus plan tolerance: expected a number in (0, 1), got {quote(self.tolerance)}")
        number = isinstance(self.seconds, (int, float)) and not isinstance(self.seconds, bool)
        if not (number and 1.0 <= self.seconds <= 3600.0):
            raise InputError(f"corpus plan seconds: expected 1 to 3600, got {quote(self.seconds)}")

    @property
    def tested(self) -> int:
        """How many of the people are in test: the last ones."""
        return max(1, round(TEST_SHARE * self.identities))

    @property
    def trained(self) -> int:
        """How many of them are in training: the first ones."""
        return self.identities - self.tested

    @property
    def static_frames(self) -> int:
        """All static frames."""
        return self.identities * self.groups * self.frames

    def split(self, identity: int) -> Split:
        """Name the split of a person."""
        return "train" if identity < self.trained else "test"

    def rng(self, *key: int) -> np.random.Generator:
        """Return random numbers of one purpose."""
        return np.random.default_rng([self.seed, *key])

    @cached_property
    def recordings(self) -> dict[str, Recording]:
        """All recordings by name."""
        every = recordings(
            self.takes or None,
            spoken=None if self.sources["speech"] > 0 else (),
            conversations=self.conversations,
            random=self.random,
            hard=self.hard,
            seconds=self.seconds,
        )
        return {name: recording for name, recording in every.items() if self.sources[recording.kind] > 0}

    @cached_property
    def pools(self) -> dict[Split, dict[str, list[str]]]:
        """Names of the recordings of each split by source: of each source a tenth, but at least one, is in test.

        InputError where a source has one recording only.
        """
        pools: dict[Split, dict[str, list[str]]] = {"train": {}, "test": {}}
        for number, source in enumerate(SOURCES):
            names = [name for name, recording in self.recordings.items() if recording.kind == source]
            if not names:
                continue
            if len(names) == 1:
                raise InputError(f"corpus plan: one {source} recording ({names[0]}) cannot be in training and in test")
            order = self.rng(SPLITTING, number).permutation(len(names))
            tested = max(1, round(TEST_SHARE * len(names)))
            pools["test"][source] = [names[k] for k in order[:tested]]
            pools["train"][source] = [names[k] for k in order[tested:]]
        if not pools["train"]:
            raise InputError("corpus plan: no recordings; give takes, conversations or random combinations")
        return pools

    def parameter_numbers(self, identity: int) -> list[int]:
        """Return the numbers of a person's parameter sets, one per group: a random pairing within the split."""
        first = 0 if self.split(identity) == "train" else self.trained
        people = self.tested if first else self.trained
        order = self.rng(PAIRING, int(bool(first))).permutation(people * self.groups)
        mine = (identity - first) * self.groups + np.arange(self.groups)
        return [int(first * self.groups + order[k]) for k in mine]

    def parameter_set(self, number: int) -> ParameterSet:
        """Draw the parameter set of a number."""
        rng = self.rng(PARAMETERS, number)
        kind = str(rng.choice(KINDS, p=[self.kinds[name] for name in KINDS]))
        return draw(rng, kind, field=bool(rng.random() < self.varying))

    def has_responses(self, parameter_number: int) -> bool:
        """Tell whether the group with this parameter set has derivatives."""
        return bool(self.rng(PARAMETERS, parameter_number, 1).random() < self.responses)

    def static(self, identity: int, index: int) -> Static:
        """Draw a person's static frame; those of group g are numbered from g * frames."""
        rng = self.rng(STATIC, identity, index)
        name = self._draw_recording(rng, identity)
        return Static(name, int(rng.integers(self.recordings[name].frames)))

    def statics(self, identity: int, group: int) -> list[Static]:
        """Draw all static frames of a person's group."""
        return [self.static(identity, group * self.frames + frame) for frame in range(self.frames)]

    def sequence(self, identity: int, index: int) -> tuple[str, int]:
        """Draw a person's sequence: the recording's name and its first frame; no gap of a take is in it."""
        rng = self.rng(DYNAMIC, identity, index)
        while True:
            name = self._draw_recording(rng, identity, STILL)
            begins = starts(self.take(name), LENGTH)
            if len(begins):
                return name, int(rng.choice(begins))

    def _draw_recording(self, rng: np.random.Generator, identity: int, without: Sequence[str] = ()) -> str:
        pool = {name: rows for name, rows in self.pools[self.split(identity)].items() if name not in without}
        share = np.array([self.sources[source] for source in pool])
        names = pool[list(pool)[rng.choice(len(pool), p=share / share.sum())]]
        count = np.array([self.recordings[name].frames for name in names], dtype=np.float64)
        return names[rng.choice(len(names), p=count / count.sum())]

    def take(self, name: str) -> Take:
        """Read a recording's take; it is kept."""
        if name not in self._takes:
            self._takes[name] = self.recordings[name].take()
        return self._takes[name]

    @cached_property
    def _takes(self) -> dict[str, Take]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the fields alone; another process derives the rest again."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def weights(self, static: Static) -> Floats32:
        """Read the ARKit weights of a static frame, shape (52,)."""
        return self.take(static.recording).weights[static.frame].astype(np.float32)

    def to_json(self) -> str:
        """Write the plan and its recordings as one line of JSON; the takes' content counts, not their folder."""
        content = asdict(replace(self, takes="")) | {
            "recordings": {name: [r.kind, r.frames, r.rate, _text(r)] for name, r in self.recordings.items()}
        }
        return json.dumps(content, sort_keys=True)

    @cached_property
    def digest(self) -> str:
        """A name for the plan, 16 hexadecimal digits."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()[:16]

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> CorpusPlan:
        """Make a plan of named options, as a TOML file has them; `preset` names one to begin with.

        Raises InputError for an unknown name.
        """
        options = dict(options)
        preset = options.pop("preset", "small")
        if not isinstance(preset, str) or preset not in PRESETS:
            raise InputError(f"corpus preset {quote(preset)!r}: there are {', '.join(PRESETS)}")
        known = [item.name for item in fields(cls)]
        for name in options:
            if name not in known:
                raise InputError(f"corpus plan: unknown option {quote(name)!r}; there are preset, {', '.join(known)}")
        return replace(PRESETS[preset], **options)


def read_plan(path: str | os.PathLike[str]) -> CorpusPlan:
    """Read the plan in a TOML file (see `CorpusPlan.of`); InputError, one line, names the file and the field."""
    path = Path(path)
    options = read_toml(path)
    try:
        plan = CorpusPlan.of(options)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    takes = path.parent / plan.takes if plan.takes else None
    return plan if takes is None else replace(plan, takes=str(takes))


def _text(recording: Recording) -> str:
    return (
        hashlib.sha256(recording.take().weights.tobytes()).hexdigest()[:16]
        if recording.kind == "real"
        else (recording.origin)
    )


def _is_share(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0.0 <= value <= 1.0


def _shares(name: str, given: Any, known: tuple[str, ...]) -> dict[str, float]:
    """Return shares of all names, which add up to 1."""
    if not isinstance(given, Mapping) or set(given) - set(known) or not all(map(_is_share, given.values())):
        raise InputError(f"corpus plan {name}: expected shares in [0, 1] of {', '.join(known)}, got {quote(given)}")
    total = sum(given.values())
    if total <= 0:
        raise InputError(f"corpus plan {name}: all shares are zero")
    # Shares that add up to 1 but for rounding stay, so that a plan read from its own text is the same plan.
    scale = 1.0 if abs(total - 1.0) < 1e-9 else total
    return {item: given.get(item, 0.0) / scale for item in known}


_FRESH = CorpusPlan(
    seed=4711,
    identities=30,
    groups=4,
    frames=6,
    sequences=0,
    kinds={"materials": 0.3, "single": 0.35, "effects": 0.15, "both": 0.2},
    sources={"conversation": 0.5, "hard": 0.5},
    conversations=10,
    random=0,
    hard=10,
    seconds=53.0,
)
# No two have a seed in common: a person follows from seed and number alone. The first person of a plan is that of
# `np.random.default_rng(seed)`, since SeedSequence ignores trailing zeros: what networks learn from has large seeds.
PRESETS: dict[str, CorpusPlan] = {
    # Every part but references once, in seconds: for tests and for trying a set-up.
    "tiny": CorpusPlan(identities=3, groups=1, frames=2, conversations=3, random=3, hard=3, seconds=4.0, run=24),
    # `make study` tests the surrogate on these: other people, parameters and recordings than those it has learned from.
    "study": replace(
        _FRESH,
        seed=94,
        identities=6,
        groups=3,
        frames=4,
        kinds={"materials": 0.35, "single": 0.45, "effects": 0.1, "both": 0.1},
        seconds=47.0,
    ),
    # The model card is measured on these: people nobody trained on, half of their frames of hard expressions.
    "fresh": _FRESH,
    # The same in motion, and beside converged elements.
    "moving": replace(_FRESH, seed=4712, identities=12, groups=2, sequences=1, references=4),
    # For people of another space in the default's triangles.
    "external": replace(_FRESH, seed=4713, identities=6, groups=2, sequences=1),
    "small": CorpusPlan(seed=1001),
    # Frames that teach what lies beyond the first order, and sequences.
    "contact": CorpusPlan(seed=1004, identities=100, frames=7),
    # Neutral faces and their derivatives alone, six for the price of one of the others: faces limit what is learned.
    # Hardly anything touches where a face is at rest.
    "faces": CorpusPlan(
        seed=1003,
        identities=1250,
        groups=4,
        frames=0,
        sequences=0,
        kinds={"materials": 0.15, "single": 0.25, "effects": 0.25, "both": 0.35},
        contact=False,
    ),
    # SoftDECA's 500,000 frames, a quarter of them in sequences.
    "paper": CorpusPlan(
        seed=1002,
        identities=7813,
        groups=4,
        frames=12,
        responses=0.1,
        conversations=400,
        random=400,
    ),
}
