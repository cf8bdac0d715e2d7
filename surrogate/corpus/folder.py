"""A corpus is a folder: corpus.json (what it is of) and one shard per person. Generate, status, verify."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.files.resumable import check_manifest, lock_folder
from ...lhm.base.mesh import Surface
from ...lhm.base.progress import OnProgress, silent
from ...reference.face.sequence import Velocities
from .intact import check_intact, check_shard, read_intact
from .manifest import MANIFEST, Manifest, read_manifest, read_template, write_template
from .mixture import NAMES
from .people import People
from .plan import CorpusPlan
from .schedule import Schedule, run_items
from .sequences import load_velocities
from .shard import ACCEPTED, FORMAT, Shard, read_arrays_of, read_label, read_seconds, write_shard
from .simulate import GENERATOR, simulate_person
from .surface_hash import surface_hash

SERIAL = Schedule()
OWN = ("person-*", "corpus", "template", "velocities", "README", "figures", "croissant")
"""Files of a corpus, without their endings."""


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
    """Counts of a corpus: people done of all; rows asked for and accepted by table; rejections.

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
        """The share of static and sequence frames made that is rejected."""
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
        self._named = describe_simulation(plan, people) | {"format": FORMAT}
        if (self.folder / MANIFEST).exists():
            self._check_plan(read_manifest(self.folder))
            check_manifest(self.folder / MANIFEST, "corpus", self._named)

    @cached_property
    def manifest(self) -> Manifest:
        """What the folder's corpus.json says, or will say."""
        said = self._named | {
            "parameters": list(NAMES),
            "code_size": self.people.code_size,
            "content": json.loads(self.plan.to_json()),
            "tested": self.plan.tested,
            "pools": self.plan.pools,
            "takes": str(Path(self.plan.takes).resolve()) if self.plan.takes else "",
            "made_with": self._made_with,
        }
        return Manifest(self.folder, said, self.plan, self._made_with)

    def _check_plan(self, kept: Manifest) -> None:
        """Raise InputError, naming each field that differs, where the folder's corpus is of another plan."""
        if kept.said["plan"] == self.plan.digest:
            return
        differing = [
            f"{item.name} {quote(getattr(kept.counts, item.name))}, expected {quote(getattr(self.plan, item.name))}"
            for item in fields(CorpusPlan)
            if item.name != "takes" and getattr(kept.counts, item.name) != getattr(self.plan, item.name)
        ]
        what = "; ".join(differing) or "its recordings are others"
        raise InputError(f"{self.folder}: holds a corpus of another plan ({what}); use another folder or remove it")

    @property
    def owner(self) -> str:
        """What each shard names as its corpus."""
        return self.manifest.owner

    def shard_path(self, identity: int) -> Path:
        """Return the place of a person's shard."""
        return self.manifest.shard_path(identity)

    def people_there(self) -> list[int]:
        """List the numbers of people whose shards are there, usable or not."""
        return [k for k in range(self.plan.identities) if self.shard_path(k).exists()]

    def generate(self, *, on: Schedule = SERIAL, on_progress: OnProgress = silent) -> CorpusStatus:
        """Simulate what is missing or damaged; the content depends on plan and people only, not on workers or order.

        Raises InputError where another generation runs in the folder, it cannot be written, or files of it are removed
        or changed meanwhile, and SoftdecaError if a worker dies again and again.
        """
        with lock_folder(self.folder, "generation of a corpus"):
            for leftover in chain.from_iterable(self.folder.glob(f".{name}-*") for name in OWN):
                leftover.unlink(missing_ok=True)  # of a process that was killed while it wrote
            pending = [k for k in self._order() if not self.is_whole(k)]
            self._write_manifest()
            if self.plan.sequences and pending:
                self._velocities(on_progress)
            rate = _Rate(self.plan, len(pending), on_progress)
            for seconds in run_items(self.make, pending, on=on, name="corpus"):
                rate.add(seconds)
            status = self.status(on_progress=on_progress)
            if status.identities_done + len(status.damaged) < status.identities:
                raise self._describe_removal(status.identities_done)
            self._check_kept()
        return status

    def _check_kept(self) -> None:
        """Raise InputError where corpus.json or template.npz is not what was written when the generation began."""
        try:
            read_template(self.folder)
            is_kept = read_manifest(self.folder).said == json.loads(json.dumps(self.manifest.said))
        except InputError as error:
            raise InputError(f"{error}; it changed while the corpus was made, run again") from None
        if not is_kept:
            raise InputError(f"{self.folder / MANIFEST}: it changed while the corpus was made; run again")

    def _describe_removal(self, done: int) -> InputError:
        return InputError(
            f"{self.folder}: files were removed while the corpus was made, {done} of {self.plan.identities} people are "
            "there; run again"
        )

    def _order(self) -> list[int]:
        """Order all people, those in test spread among the others: a part of a corpus can be learned from, too."""
        count = {"train": self.plan.trained, "test": self.plan.tested}
        begins = {"train": 0, "test": count["train"]}

        def place(identity: int) -> float:
            split = self.plan.split(identity)
            return (identity - begins[split] + 0.5) / count[split]

        return sorted(range(self.plan.identities), key=place)

    def make(self, identity: int) -> float:
        """Simulate one person and write the shard; returns the processor seconds that it took."""
        if not (self.folder / MANIFEST).exists():
            raise self._describe_removal(len(self.people_there()))
        begin = time.process_time()
        velocities = self._velocities() if self.plan.sequences else None
        shard = simulate_person(self.plan, self.people, identity, velocities)
        try:
            check_shard(shard, self.manifest, self.people.mean, identity)
        except InputError as error:
            raise InputError(f"person {identity}: {error}") from None
        write_shard(self.shard_path(identity), shard, self.owner)
        return time.process_time() - begin

    def _velocities(self, on_progress: OnProgress = silent) -> Velocities:
        if self._run is None:
            self._run = load_velocities(self.folder, self.plan, self.people, on_progress=on_progress)
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
        return read_intact(self.manifest, self.people.mean, identity)

    def status(self, *, on_progress: OnProgress = silent) -> CorpusStatus:
        """Count what is there: see `read_status`."""
        return read_status(self.manifest, self.people.mean, on_progress=on_progress)

    def _write_manifest(self):
        write_template(self.folder, self.people.mean)
        write_whole(self.folder / MANIFEST, json.dumps(self.manifest.said, indent=1).encode())


def sum_seconds(timed: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Add up people's seconds by phase; empty if those of one are not known."""
    if not all(timed):
        return {}
    return {phase: sum(spent.get(phase, 0.0) for spent in timed) for phase in dict.fromkeys(chain(*timed))}


def read_status(manifest: Manifest, mean: Surface, *, on_progress: OnProgress = silent) -> CorpusStatus:
    """Count what is there, and list what was rejected or is damaged, in a corpus with this mean skin.

    Every shard is read whole, once per process; see `intact`.
    """
    plan, owner = manifest.counts, manifest.owner
    tables = ("groups", "statics", "sequences", "references")
    asked, accepted = dict.fromkeys((*tables, "responses"), 0), dict.fromkeys((*tables, "responses"), 0)
    rejected, damaged, done, size = [], [], 0, 0
    versions: dict[str, int] = {}
    timed: list[dict[str, float]] = []
    names = [f"{table}/status" for table in tables] + ["responses/group", "sequences/iterations"]
    for identity in range(plan.identities):
        path = manifest.shard_path(identity)
        if not path.exists():
            continue
        try:
            check_intact(manifest, mean, identity)
            arrays, label, spent = read_arrays_of(path, owner, *names), read_label(path), read_seconds(path)
        except InputError as error:
            damaged.append(str(error) if str(path.with_suffix("")) in str(error) else f"shard {path}: {error}")
            continue
        done, size = done + 1, size + path.stat().st_size
        versions[label.version] = versions.get(label.version, 0) + 1
        timed.append(spent)
        on_progress("check", (identity + 1) / plan.identities)
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
        plan.identities, done, asked, accepted, tuple(rejected), tuple(damaged), versions, sum_seconds(timed), size
    )


def verify_folder(folder: str | PathLike[str], *, on_progress: OnProgress = silent) -> int:
    """Read every shard of a corpus whole, and return how many there are.

    InputError names the first that is missing, damaged, of another corpus or person, or whose seconds are damaged, or
    the template; see `intact`.
    """
    manifest, mean = read_manifest(folder), read_template(folder)
    people = manifest.counts.identities
    for identity in range(people):
        read_intact(manifest, mean, identity)
        read_seconds(manifest.shard_path(identity))
        on_progress("verify", (identity + 1) / people)
    return people


def describe_simulation(plan: CorpusPlan, people: People) -> dict[str, Any]:
    """Name what decides simulated frames: plan, people, template and generator."""
    template = f"{surface_hash(people.mean)}{people.digest}"
    return {"plan": plan.digest, "people": people.name, "template": template, "generator": GENERATOR}


def read_kept_plan(folder: str | PathLike[str]) -> CorpusPlan:
    """Return a corpus' plan from its folder; InputError for other recordings, and people that no command knows."""
    manifest = read_manifest(folder)
    _ = manifest.known_people
    takes = manifest.said.get("takes", "")
    plan = replace(manifest.counts, takes=takes)
    if plan.digest != manifest.said["plan"]:
        raise InputError(
            f"corpus {folder}: its recordings are not what they were (takes in {takes or 'none'}); make another one"
        )
    return plan


class _Rate:
    """Progress of a generation: people done, frames per core-hour, time left."""

    def __init__(self, plan: CorpusPlan, pending: int, progress: OnProgress):
        self._plan, self._left, self._progress = plan, pending, progress
        self._done, self._begin, self._spent = 0, time.monotonic(), 0.0
        progress(f"corpus: {plan.identities - pending} of {plan.identities} people are there", 0.0)

    def add(self, seconds: float):
        self._done, self._left, self._spent = self._done + 1, self._left - 1, self._spent + seconds
        wall = time.monotonic() - self._begin
        people = self._plan.identities - self._left
        frames = self._plan.groups * self._plan.frames * self._done * 3600.0 / max(self._spent, 1e-9)
        remaining = wall / self._done * self._left
        self._progress(
            f"corpus: {people} of {self._plan.identities} people, {frames:.0f} static frames a core-hour with all that "
            f"belongs to them, {describe_duration(remaining)} left",
            people / self._plan.identities,
        )


def shorten_reason(reason: str) -> str:
    """Return the reason of a rejection without its numbers, which differ from row to row."""
    return re.sub(r"[0-9.]*[0-9]", "N", reason)[:80]


def describe_duration(seconds: float) -> str:
    """Return seconds as minutes, or as hours and minutes."""
    minutes = int(seconds / 60.0 + 0.5)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"
