"""A corpus is a folder: corpus.json (what it is of) and one shard per person. Generate, status, verify."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.files.resumable import check_manifest, lock_folder
from ...lhm.base.progress import OnProgress, silent
from ...reference.face.sequence import Velocities
from ..schedule import Schedule, results_of
from ..surface_hash import surface_hash
from .intact import REMEDY, check_person, read_intact
from .manifest import MANIFEST, CorpusTemplate, read_manifest, read_template, write_template
from .mixture import NAMES
from .people import People
from .plan import IDENTITY, CorpusPlan, Split
from .sequences import velocities_of
from .shard import ACCEPTED, FORMAT, Shard, read_arrays_of, read_label, read_seconds, read_shard, write_shard
from .simulate import GENERATOR, simulate_person

SERIAL = Schedule()
PARTIAL = ".person-*"
"""What a process that was killed while it wrote leaves behind."""


@dataclass(frozen=True)
class Rejection:
    """A frame, sequence or derivative that training and test do not use, and why.

    table: "groups", "statics", "sequences" or "references"; row: its number there.
    """

    identity: int
    table: str
    row: int
    reason: str


@dataclass(frozen=True)
class CorpusStatus:
    """What a corpus holds: people done of all; counts of what was accepted, by table; what was rejected, of `asked`.

    `damaged`: shards that are there but cannot be used, by message; `seconds`: of one process, by phase, summed over
    people, and empty where those of one are not known; `bytes` of all shards.
    """

    identities: int
    identities_done: int
    asked: dict[str, int]
    accepted: dict[str, int]
    rejected: tuple[Rejection, ...]
    damaged: tuple[str, ...]
    versions: dict[str, int]
    seconds: dict[str, float]
    bytes: int

    @property
    def rejected_share(self) -> float:
        """Of static and sequence frames made."""
        asked = self.asked["statics"] + self.asked["sequences"]
        accepted = self.accepted["statics"] + self.accepted["sequences"]
        return 1.0 - accepted / asked if asked else 0.0


class Corpus:
    """A corpus of one plan and of some people, in a folder.

    `made_with`: what the folder notes of how to make `people` again. Raises InputError if the folder holds a corpus of
    another plan, template or generator.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        plan: CorpusPlan,
        people: People,
        made_with: Mapping[str, Any] = MappingProxyType({}),
    ):
        self.folder, self.plan, self.people, self._made_with = Path(folder), plan, people, dict(made_with)
        self._run: Velocities | None = None
        self.manifest = simulated_of(plan, people) | {"format": FORMAT}
        if check_manifest(self.folder / MANIFEST, "corpus", self.manifest):
            read_manifest(self.folder)

    @property
    def owner(self) -> str:
        """What each shard names as its corpus."""
        return "-".join(map(str, self.manifest.values()))

    def shard_path(self, identity: int) -> Path:
        """Where a person's shard is, or will be."""
        return shard_path(self.folder, identity)

    def people_there(self) -> list[int]:
        """The numbers of the people whose shards are there, usable or not."""
        return [k for k in range(self.plan.identities) if self.shard_path(k).exists()]

    def generate(self, *, on: Schedule = SERIAL, on_progress: OnProgress = silent) -> CorpusStatus:
        """Simulate what is missing or damaged; the content depends on plan and people only, not on workers or order.

        Raises InputError where another generation runs in the folder or it cannot be written, and SoftdecaError if a
        worker dies again and again.
        """
        with lock_folder(self.folder, "generation of a corpus"):
            for left in self.folder.glob(PARTIAL):
                left.unlink(missing_ok=True)
            pending = [k for k in self._order() if not self.is_whole(k)]
            self._write_manifest()
            if self.plan.sequences and pending:
                self._velocities(on_progress)
            rate = _Rate(self.plan, len(pending), on_progress)
            for seconds in results_of(self.make, pending, on=on, name="corpus"):
                rate.add(seconds)
        return self.status()

    def _order(self) -> list[int]:
        """All people, those in test spread among the others, so that a part of a corpus is one to learn from, too."""
        count = {"train": self.plan.trained, "test": self.plan.tested}
        begins = {"train": 0, "test": count["train"]}

        def place(identity: int) -> float:
            split = self.plan.split(identity)
            return (identity - begins[split] + 0.5) / count[split]

        return sorted(range(self.plan.identities), key=place)

    def make(self, identity: int) -> float:
        """Simulate one person and write the shard; returns the processor seconds that it took."""
        begin = time.process_time()
        velocities = self._velocities() if self.plan.sequences else None
        shard = simulate_person(self.plan, self.people, identity, velocities)
        write_shard(self.shard_path(identity), shard, self.owner)
        return time.process_time() - begin

    def _velocities(self, on_progress: OnProgress = silent) -> Velocities:
        if self._run is None:
            self._run = velocities_of(self.folder, self.plan, self.people, on_progress=on_progress)
        return self._run

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_run": None}

    def is_whole(self, identity: int) -> bool:
        """Whether a person's shard is there, whole, and of this corpus."""
        try:
            self.shard(identity)
        except InputError:
            return False
        return True

    def shard(self, identity: int) -> Shard:
        """Read one person's shard; InputError if it is missing, damaged, or of another corpus or person."""
        path = self.shard_path(identity)
        shard = read_shard(path, self.owner)
        try:
            check_person(shard.groups.number, self.plan.parameter_numbers(identity))
        except InputError as error:
            raise InputError(f"shard {path}: {error}; {REMEDY}") from None
        return shard

    def shards(self, split: Split | None = None) -> Iterator[tuple[int, Shard]]:
        """All people's shards of a split, or of both, one after another; InputError for one that cannot be used."""
        for identity in range(self.plan.identities):
            if split in (None, self.plan.split(identity)):
                yield identity, self.shard(identity)

    def verify(self, *, on_progress: OnProgress = silent) -> None:
        """Check every shard against its checksum; InputError names the first that is missing or damaged."""
        for identity in range(self.plan.identities):
            self.shard(identity)
            on_progress("verify", (identity + 1) / self.plan.identities)

    def status(self) -> CorpusStatus:
        """Count what is there: see `status_of`."""
        return status_of(self.folder, self.plan, self.owner)

    def _write_manifest(self):
        content = self.manifest | {
            "parameters": list(NAMES),
            "content": json.loads(self.plan.to_json()),
            "tested": self.plan.tested,
            "pools": self.plan.pools,
            "takes": str(Path(self.plan.takes).resolve()) if self.plan.takes else "",
            "made_with": self._made_with,
        }
        person = self.people.person(self.plan.rng(IDENTITY, 0))
        write_template(self.folder, CorpusTemplate(self.people.mean, None if person.personal else person.shapes))
        write_whole(self.folder / MANIFEST, json.dumps(content, indent=1).encode())


def summed(timed: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Add up people's seconds by phase; empty if those of one are not known."""
    if not all(timed):
        return {}
    return {phase: sum(spent.get(phase, 0.0) for spent in timed) for phase in dict.fromkeys(chain(*timed))}


def status_of(folder: Path, plan: CorpusPlan, owner: str) -> CorpusStatus:
    """Count what is there, and list what was rejected or is damaged, in the folder of a corpus by its plan and name.

    Only small arrays are read, unchecked; see `verify_folder`.
    """
    tables = ("groups", "statics", "sequences", "references")
    asked, accepted = dict.fromkeys((*tables, "responses"), 0), dict.fromkeys((*tables, "responses"), 0)
    rejected, damaged, done, size = [], [], 0, 0
    versions: dict[str, int] = {}
    timed: list[dict[str, float]] = []
    names = [f"{table}/status" for table in tables] + ["groups/number", "responses/group", "sequences/iterations"]
    for identity in range(plan.identities):
        path = shard_path(folder, identity)
        if not path.exists():
            continue
        try:
            arrays, label, spent = read_arrays_of(path, owner, *names), read_label(path), read_seconds(path)
            check_person(arrays["groups/number"], plan.parameter_numbers(identity))
        except InputError as error:
            damaged.append(str(error) if str(path) in str(error) else f"shard {path}: {error}")
            continue
        done, size = done + 1, size + path.stat().st_size
        versions[label.version] = versions.get(label.version, 0) + 1
        timed.append(spent)
        for table in tables:
            status = arrays[f"{table}/status"]
            each = arrays["sequences/iterations"].shape[1] if table == "sequences" else 1
            good = status == ACCEPTED.encode()
            asked[table] += each * len(status)
            accepted[table] += each * int(good.sum())
            rejected += [Rejection(identity, table, int(k), status[k].decode()) for k in np.flatnonzero(~good)]
        asked["responses"] += len(arrays["responses/group"])
        accepted["responses"] += len(arrays["responses/group"])
    return CorpusStatus(
        plan.identities, done, asked, accepted, tuple(rejected), tuple(damaged), versions, summed(timed), size
    )


def verify_folder(folder: str | PathLike[str], *, on_progress: OnProgress = silent) -> int:
    """Read every shard of a corpus whole, and return how many there are.

    InputError names the first that is missing, damaged, or of another corpus or person; see `intact`.
    """
    manifest, n = read_manifest(folder), len(read_template(folder).mean.vertices)
    people = manifest.counts.identities
    for identity in range(people):
        read_intact(shard_path(manifest.folder, identity), manifest, identity, n)
        on_progress("verify", (identity + 1) / people)
    return people


def shard_path(folder: Path, identity: int) -> Path:
    """Where a person's shard lies in a corpus' folder."""
    return folder / f"person-{identity:05d}.h5"


def simulated_of(plan: CorpusPlan, people: People) -> dict[str, Any]:
    """What frames are simulated of, by name: where it differs they are others."""
    template = f"{surface_hash(people.mean)}{people.digest}"
    return {"plan": plan.digest, "people": people.name, "template": template, "generator": GENERATOR}


def known_plan(folder: str | PathLike[str]) -> tuple[CorpusPlan, dict[str, Any]]:
    """Return a corpus' plan, and how to make its people again, from its folder; InputError where that is not told."""
    manifest = read_manifest(folder)
    takes = manifest.said.get("takes", "")
    plan, made_with = replace(manifest.counts, takes=takes), dict(manifest.made_with)
    if not (isinstance(made_with.get("identities"), str) and made_with.get("level") in (1, 2, 3)):
        raise InputError(f"corpus {folder}: it was made from Python, of people that no command knows by name")
    if plan.digest != manifest.said["plan"]:
        raise InputError(
            f"corpus {folder}: its recordings are not what they were (takes in {takes or 'none'}); make another one"
        )
    return plan, made_with


class _Rate:
    """Says how many people are done, how fast, and how long the rest takes."""

    def __init__(self, plan: CorpusPlan, pending: int, progress: OnProgress):
        self._plan, self._left, self._progress = plan, pending, progress
        self._done, self._begin, self._spent = 0, time.monotonic(), 0.0
        progress(f"corpus: {plan.identities - pending} of {plan.identities} people are there", 0.0)

    def add(self, seconds: float):
        self._done, self._left, self._spent = self._done + 1, self._left - 1, self._spent + seconds
        wall = time.monotonic() - self._begin
        people = self._plan.identities - self._left
        frames = self._plan.groups * self._plan.frames * self._done * 3600.0 / max(self._spent, 1e-9)
        left = wall / self._done * self._left
        self._progress(
            f"corpus: {people} of {self._plan.identities} people, {frames:.0f} static frames a core-hour with all that "
            f"belongs to them, {_duration(left)} left",
            people / self._plan.identities,
        )


def _duration(seconds: float) -> str:
    minutes = int(seconds / 60.0 + 0.5)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"
