"""A corpus is a folder: corpus.json (plan and template) and one shard per identity. Generate, verify, read."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Protocol

import numpy as np

from ..lhm.errors import InputError
from ..lhm.files.atomic import replaced
from ..lhm.identities import IdentitySpace
from ..lhm.mesh import Surface
from ..lhm.progress import OnProgress, silent
from .plan import CorpusPlan, Split
from .pool import results_of
from .samples import Samples, surface_hash
from .shard import Shard, read_shard, write_shard
from .simulate import Fit, simulate_identity


class CorpusSpace(IdentitySpace, Protocol):
    """What a corpus asks of a space of identities; it has to be picklable for worker processes."""

    @property
    def mean(self) -> Surface:
        """The mean neutral skin [mm]; with its triangles it stands for the template."""
        ...


@dataclass(frozen=True)
class Rejection:
    """A frame that training and test do not use, and why."""

    identity: int
    frame: int
    reason: str


@dataclass(frozen=True)
class CorpusStatus:
    """What a corpus holds: identities done of all, frames accepted, those rejected, and damaged shards by message."""

    identities: int
    identities_done: int
    accepted: int
    rejected: tuple[Rejection, ...]
    damaged: tuple[str, ...]


class Corpus:
    """A corpus of one plan and space in a folder.

    Raises InputError if the folder holds a corpus of another plan or template.
    """

    def __init__(self, folder: str | PathLike[str], plan: CorpusPlan, space: CorpusSpace):
        self.folder, self.plan, self.space = Path(folder), plan, space
        self._manifest = {"plan": plan.digest, "space": space.name, "template": surface_hash(space.mean)}
        found = self._read_manifest()
        for key, value in self._manifest.items():
            if found is not None and found.get(key) != value:
                raise InputError(
                    f"corpus {self.folder}: of another {key} ({found.get(key)}, expected {value}); use another folder"
                )

    @property
    def owner(self) -> str:
        """What each shard names as its corpus."""
        return "-".join(self._manifest.values())

    def _read_manifest(self) -> dict | None:
        path = self.folder / "corpus.json"
        if not path.exists():
            return None
        try:
            manifest = json.loads(path.read_text())
            return {key: manifest[key] for key in self._manifest}
        except (OSError, ValueError, KeyError, TypeError):
            raise InputError(f"corpus {path}: damaged, or not a corpus of softdeca; use another folder") from None

    def shard_path(self, identity: int) -> Path:
        """Where an identity's shard is, or will be."""
        return self.folder / f"identity-{identity:05d}.h5"

    def generate(self, fit: Fit, *, workers: int = 1, on_progress: OnProgress = silent) -> CorpusStatus:
        """Simulate what is missing or damaged; the content depends on plan and space only, not on workers or order.

        `fit` makes a head of a skin. Raises InputError for fewer than one worker, and SoftdecaError if a worker dies.
        """
        if workers < 1:
            raise InputError(f"workers: must be at least 1, got {workers}")
        pending = [k for k in range(self.plan.people) if not self._is_whole(k)]
        with replaced(self.folder / "corpus.json") as temporary:
            content = {**self._manifest, "content": json.loads(self.plan.to_json())}
            temporary.write_text(json.dumps(content, indent=1))
        done = self.plan.people - len(pending)
        for identity in results_of(partial(self.make, fit=fit), pending, workers=workers, name="corpus"):
            done += 1
            on_progress(f"corpus: identity {identity} simulated", done / self.plan.people)
        return self.status()

    def make(self, identity: int, fit: Fit) -> int:
        """Simulate one identity and write its shard; returns the identity."""
        write_shard(self.shard_path(identity), simulate_identity(self.plan, identity, self.space, fit), self.owner)
        return identity

    def _is_whole(self, identity: int) -> bool:
        try:
            self.shard(identity)
        except InputError:
            return False
        return True

    def shard(self, identity: int) -> Shard:
        """One identity's frames; InputError if the shard is missing, damaged or of another corpus."""
        return read_shard(self.shard_path(identity), self.owner)

    def verify(self) -> None:
        """Check every shard against its checksum; InputError names the first that is missing or damaged."""
        for identity in range(self.plan.people):
            self.shard(identity)

    def status(self) -> CorpusStatus:
        """Count what is there, and list what was rejected or is damaged."""
        accepted, rejected, damaged, done = 0, [], [], 0
        for identity in range(self.plan.people):
            try:
                shard = self.shard(identity)
            except InputError as error:
                if self.shard_path(identity).exists():
                    damaged.append(str(error))
                continue
            done += 1
            accepted += int(shard.accepted.sum())
            rejected += [Rejection(identity, int(k), shard.status[k].decode()) for k in np.flatnonzero(~shard.accepted)]
        return CorpusStatus(self.plan.people, done, accepted, tuple(rejected), tuple(damaged))

    def samples(self, split: Split) -> Samples:
        """The accepted frames of a split; InputError for shards that are missing or damaged, or if none is accepted."""
        people = [k for k in range(self.plan.people) if self.plan.split(k) == split]
        shards = [self.shard(k) for k in people]
        masks = [shard.accepted for shard in shards]
        counts = [int(mask.sum()) for mask in masks]
        if sum(counts) == 0:
            raise InputError(f"corpus {self.folder}: no frame of the {split} split was accepted; see its status")
        pairs = list(zip(shards, masks, strict=True))
        blended = np.concatenate([(s.skin + s.moved[m]).astype(np.float32) for s, m in pairs])
        return Samples(
            reference=self.space.mean,
            space=self.space.name,
            parameter_names=self.plan.parameter_names,
            identity=np.repeat(people, counts),
            codes=np.repeat(np.stack([s.code for s in shards]), counts, axis=0).astype(np.float32),
            weights=np.concatenate([s.weights[m] for s, m in pairs]).astype(np.float32),
            parameters=np.concatenate([s.parameters[m] for s, m in pairs]),
            blended=blended,
            simulated=blended + np.concatenate([s.corrected[m] for s, m in pairs]).astype(np.float32),
        )
