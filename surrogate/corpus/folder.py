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
from ...lhm.base.files.resumable import lock_folder
from ...lhm.base.mesh import Surface
from ...lhm.base.progress import OnProgress, describe_duration, silent
from ...reference.face.sequence import Velocities
from .face import Heads, People
from .manifest import (
    MANIFEST,
    OWNER,
    check_template,
    describe_corpus,
    read_manifest,
    read_template,
    write_manifest,
    write_template,
)
from .people import people_from_text
from .plan import CorpusPlan
from .schedule import Schedule, run_items
from .sequences import check_velocities, load_velocities
from .shard import (
    ACCEPTED,
    Shard,
    UnreadableError,
    read_arrays_of,
    read_label,
    read_seconds,
    read_shard,
    write_shard,
)
from .simulate import simulate_person

SERIAL = Schedule()
OWN = ("person-*", "corpus", "template", "velocities", "README", "figures")
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


Key = tuple[str, str, int, int, int, int]
"""Path, corpus, person; and inode, size and time of change of the file."""
_intact: set[Key] = set()
"""The shards that this process has checked."""


@dataclass(frozen=True, eq=False)
class Corpus:
    """A corpus of one plan and of some people, in a folder; `manifest`: what its corpus.json says, or will say.

    Of a corpus that was opened nobody has looked at the recordings of `plan`, and who its `people` are is not known:
    `generate` is for those of `from_plan`.
    """

    folder: Path
    plan: CorpusPlan
    manifest: Mapping[str, Any]
    people: People | None = None

    @classmethod
    def from_plan(
        cls,
        folder: str | PathLike[str],
        plan: CorpusPlan,
        people: People,
        made_with: Mapping[str, Any] = MappingProxyType({}),
    ) -> Corpus:
        """Begin a corpus of a plan in a folder, or go on with the one that lies there.

        made_with: what a command needs to make the people again. Raises InputError if the folder holds a corpus of
        another plan, people, template, generator or format, or files of one, and UnreadableError as `shard`.
        """
        corpus = cls(Path(folder), plan, describe_corpus(plan, people, made_with), people)
        described = (corpus.folder / MANIFEST).exists()
        if described:
            corpus._check_same(cls.open(folder))
        corpus._check_files(described)
        return corpus

    def _check_files(self, described: bool) -> None:
        """Raise InputError for shards, template or velocities of another corpus, which would be made anew.

        Files that are damaged are of this one, as far as its corpus.json is there.
        """
        keep = "a corpus is resumed by its own plan and people; else use another folder"
        for path in sorted(self.folder.glob("person-*.h5")):
            try:
                owner = read_label(path).owner
            except UnreadableError:
                raise
            except InputError as error:
                if described:
                    continue
                raise InputError(f"{error}, and there is no {MANIFEST}: whose it is, is not known; {keep}") from None
            if owner != self.owner:
                raise InputError(
                    f"shard {path}: of another corpus ({quote(owner, 80)}, expected {quote(self.owner, 80)}); {keep}"
                )
        check_template(self.folder, self.manifest["template"], keep)
        check_velocities(self.folder, self.plan, self.space, keep)

    @classmethod
    def open(cls, folder: str | PathLike[str]) -> Corpus:
        """Open what lies in a folder. InputError for one that is no corpus, or whose corpus.json is damaged."""
        manifest, plan = read_manifest(Path(folder))
        return cls(Path(folder), plan, manifest)

    def _check_same(self, kept: Corpus) -> None:
        """Raise InputError, naming each field of the plan that differs, where the folder's corpus is another."""
        if kept.manifest["plan"] != self.manifest["plan"]:
            differing = [
                f"{item.name} {quote(getattr(kept.plan, item.name))}, expected {quote(getattr(self.plan, item.name))}"
                for item in fields(CorpusPlan)
                if item.name != "takes" and getattr(kept.plan, item.name) != getattr(self.plan, item.name)
            ]
            what = "; ".join(differing) or "its recordings are others"
            raise InputError(f"{self.folder}: holds a corpus of another plan ({what}); use another folder or remove it")
        for name in OWNER:
            if kept.manifest[name] != self.manifest[name]:
                raise InputError(
                    f"{self.folder}: holds a corpus of another {name} ({kept.manifest[name]}, expected "
                    f"{self.manifest[name]}); use another folder or remove it"
                )

    @cached_property
    def mean(self) -> Surface:
        """The mean neutral skin [mm] of its people; InputError where template.npz is missing, damaged or another."""
        return read_template(self.folder, self.manifest["template"]) if self.people is None else self.people.mean

    @property
    def space(self) -> str:
        """The name of the people's space."""
        return str(self.manifest["people"])

    @property
    def made_with(self) -> Mapping[str, Any]:
        """Options by which a command makes the people again, empty for a corpus made from Python."""
        return self.manifest.get("made_with", {})

    def heads(self, on_progress: OnProgress = silent) -> Heads:
        """Return who fits the heads of its people, as its folder says how."""

        def make() -> People:
            identities, level = self.known_people
            return people_from_text(identities, level=level, on_progress=on_progress)

        return Heads(make)

    @property
    def known_people(self) -> tuple[str, int]:
        """The people by name and their template's level; InputError where no command knows them."""
        identities, level = self.made_with.get("identities"), self.made_with.get("level")
        if not (isinstance(identities, str) and level in (1, 2, 3)):
            raise InputError(f"corpus {self.folder}: it was made from Python, of people that no command knows by name")
        return identities, level

    def find_plan(self) -> CorpusPlan:
        """Return the plan with its recordings; InputError for other recordings, and people that no command knows."""
        _ = self.known_people
        takes = self.manifest.get("takes", "")
        plan = replace(self.plan, takes=takes)
        if plan.digest != self.manifest["plan"]:
            raise InputError(
                f"corpus {self.folder}: its recordings are not what they were (takes in {takes or 'none'}); make "
                "another one"
            )
        return plan

    @property
    def owner(self) -> str:
        """Name of the corpus in each shard."""
        return "-".join(str(self.manifest[name]) for name in OWNER)

    def shard_path(self, identity: int) -> Path:
        """Return the place of a person's shard."""
        return self.folder / f"person-{identity:05d}.h5"

    def people_there(self) -> list[int]:
        """List the numbers of people whose shards are there, usable or not."""
        return [k for k in range(self.plan.identities) if self.shard_path(k).exists()]

    def generate(self, *, on: Schedule = SERIAL, on_progress: OnProgress = silent) -> CorpusStatus:
        """Simulate what is missing or damaged; the content depends on plan and people only, not on workers or order.

        Raises InputError where another generation runs in the folder, it cannot be written, a shard cannot be read, or
        files of it are removed or changed meanwhile, and SoftdecaError if a worker dies again and again.
        """
        with lock_folder(self.folder, "generation of a corpus"):
            for leftover in chain.from_iterable(self.folder.glob(f".{name}-*") for name in OWN):
                leftover.unlink(missing_ok=True)  # of a process that was killed while it wrote
            pending = [k for k in self._order() if not self.is_whole(k)]
            self._write_manifest()
            if self.plan.sequences and pending:
                load_velocities(self.folder, self.plan, self._simulated, on_progress=on_progress)
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
            kept = Corpus.open(self.folder)
            _ = kept.mean
        except InputError as error:
            raise InputError(f"{error}; it changed while the corpus was made, run again") from None
        if kept.manifest != json.loads(json.dumps(self.manifest)):
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
        shard = simulate_person(self.plan, self._simulated, identity, self._velocities if self.plan.sequences else None)
        write_shard(self.shard_path(identity), shard, self.owner, identity)
        return time.process_time() - begin

    @property
    def _simulated(self) -> People:
        if self.people is None:
            raise InputError(f"corpus {self.folder}: it was opened to be read; `Corpus.from_plan` goes on with it")
        return self.people

    @cached_property
    def _velocities(self) -> Velocities:
        return load_velocities(self.folder, self.plan, self._simulated)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the fields alone; another process reads the rest again."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def is_whole(self, identity: int) -> bool:
        """Whether a person's shard is there, whole, and of this corpus; UnreadableError where nobody can know."""
        try:
            self.shard(identity)
        except UnreadableError:
            raise
        except InputError:
            return False
        return True

    def shard(self, identity: int) -> Shard:
        """Read one person's shard; InputError, naming the file, if it is missing, damaged, or of another.

        UnreadableError where it is locked, or the system does not let it be read.
        """
        key = self._key(identity)
        shard = read_shard(self.shard_path(identity), self.owner, identity)
        if key is not None:
            _intact.add(key)
        return shard

    def check(self, identity: int) -> None:
        """Check one person's shard as `shard` does, once per process and file: some 2 ms a megabyte."""
        key = self._key(identity)
        if key is None or key not in _intact:
            self.shard(identity)

    def _key(self, identity: int) -> Key | None:
        path = self.shard_path(identity)
        try:
            state = path.stat()
        except OSError:
            return None
        return str(path.resolve()), self.owner, identity, state.st_ino, state.st_size, state.st_mtime_ns

    def status(self, *, on_progress: OnProgress = silent) -> CorpusStatus:
        """Count what is there, and list what was rejected or is damaged. Shards are read whole, once per process.

        Raises InputError for a damaged template, and UnreadableError as `shard`.
        """
        _ = self.mean  # a damaged template is no shard's damage
        tables = ("groups", "statics", "sequences", "references")
        asked, accepted = dict.fromkeys((*tables, "responses"), 0), dict.fromkeys((*tables, "responses"), 0)
        rejected, damaged, done, size = [], [], 0, 0
        versions: dict[str, int] = {}
        timed: list[dict[str, float]] = []
        names = [f"{table}/status" for table in tables] + ["responses/group", "sequences/iterations"]
        for identity in range(self.plan.identities):
            path = self.shard_path(identity)
            if not path.exists():
                continue
            try:
                self.check(identity)
                arrays, label, spent = read_arrays_of(path, *names), read_label(path), read_seconds(path)
            except UnreadableError:
                raise
            except InputError as error:
                damaged.append(str(error) if str(path) in str(error) else f"shard {path}: {error}")
                continue
            done, size = done + 1, size + path.stat().st_size
            versions[label.version] = versions.get(label.version, 0) + 1
            timed.append(spent)
            on_progress("check", (identity + 1) / self.plan.identities)
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
            self.plan.identities,
            done,
            asked,
            accepted,
            tuple(rejected),
            tuple(damaged),
            versions,
            sum_seconds(timed),
            size,
        )

    def verify(self, *, on_progress: OnProgress = silent) -> int:
        """Read every shard whole, and return how many there are.

        InputError names the first that is missing, damaged, or of another corpus or person, or the template.
        """
        _ = self.mean
        people = self.plan.identities
        for identity in range(people):
            self.shard(identity)
            on_progress("verify", (identity + 1) / people)
        return people

    def _write_manifest(self):
        write_template(self.folder, self.mean)
        write_manifest(self.folder, self.manifest)


def sum_seconds(timed: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Add up people's seconds by phase; empty if those of one are not known."""
    if not all(timed):
        return {}
    return {phase: sum(spent.get(phase, 0.0) for spent in timed) for phase in dict.fromkeys(chain(*timed))}


class _Rate:
    """Progress of a generation: people done, frames per core-hour, time left."""

    def __init__(self, plan: CorpusPlan, pending: int, progress: OnProgress):
        self._plan, self._left, self._progress = plan, pending, progress
        self._done, self._begin, self._spent = 0, time.monotonic(), 0.0
        progress(f"corpus: {plan.identities - pending} of {plan.identities} people are there", 0.0)

    def add(self, seconds: float):
        """Count one more person, made in `seconds`, and tell the progress."""
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
