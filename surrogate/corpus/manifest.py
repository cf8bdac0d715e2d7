"""Two files of every corpus, checked before use: corpus.json, its description, and template.npz, its mean skin."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any

from ...lhm.base.checks import finite, integers, text, texts
from ...lhm.base.errors import InputError, SoftdecaError, quote
from ...lhm.base.files.npz import read_arrays, write_arrays
from ...lhm.base.files.text import read_json
from ...lhm.base.mesh import Surface
from .mixture import NAMES
from .plan import SPLITS, CorpusPlan, Split
from .shard import FARTHEST, FORMATS, READ
from .surface_hash import surface_hash

MANIFEST = "corpus.json"
TEMPLATE = "template.npz"
OWNER = ("plan", "people", "template", "generator", "format")
"""The fields that name the corpus in each of its shards."""


@dataclass(frozen=True)
class Manifest:
    """The content of corpus.json.

    said: all of it; counts: the plan with its counts, seed and shares, whose recordings nobody has looked at;
    made_with: what a command needs to make the people again, empty for a corpus made from Python.
    """

    folder: Path
    said: Mapping[str, Any]
    counts: CorpusPlan
    made_with: Mapping[str, Any]

    @property
    def known_people(self) -> tuple[str, int]:
        """The people by name and their template's level; InputError where no command knows them."""
        identities, level = self.made_with.get("identities"), self.made_with.get("level")
        if not (isinstance(identities, str) and level in (1, 2, 3)):
            raise InputError(f"corpus {self.folder}: it was made from Python, of people that no command knows by name")
        return identities, level

    @property
    def recordings(self) -> dict[str, int]:
        """Frames of each recording by name."""
        return {name: each[1] for name, each in self.said["content"]["recordings"].items()}

    def pool(self, split: Split) -> set[str]:
        """Names of the recordings of a split."""
        return {name for names in self.said["pools"][split].values() for name in names}

    @property
    def code_size(self) -> int | None:
        """How many numbers a person's code has; None where nobody says, as in format 2."""
        return self.said.get("code_size")

    def shard_path(self, identity: int) -> Path:
        """Return the place of a person's shard."""
        return self.folder / f"person-{identity:05d}.h5"

    @property
    def people(self) -> str:
        """Name of the people."""
        return str(self.said["people"])

    @property
    def owner(self) -> str:
        """The name of the corpus that each of its shards carries."""
        return "-".join(str(self.said[name]) for name in OWNER)


def read_manifest(folder: str | PathLike[str]) -> Manifest:
    """Read the corpus.json of a folder.

    Raises InputError where there is none, and names the field that is missing, of another kind or out of its range.
    """
    path = Path(folder) / MANIFEST
    if not path.exists():
        raise InputError(f"corpus {folder}: no corpus.json; `softdeca corpus generate` makes one")
    said = read_json(path, "a corpus' description")
    try:
        return _check(Path(folder), said)
    except InputError as error:
        raise InputError(f"{path}: damaged, or of no corpus of softdeca ({error}); use another folder") from None


def _check(folder: Path, said: Any) -> Manifest:
    if not isinstance(said, dict):
        raise InputError(f"expected an object, got {quote(said)}")
    for name in ("plan", "people", "template"):
        text(name, said.get(name))
    for name in ("generator", "format"):
        if isinstance(said.get(name), bool) or not isinstance(said.get(name), (int, str)):
            raise InputError(f"{name}: expected a number, got {quote(said.get(name))}")
    content, made_with = said.get("content"), said.get("made_with", {})
    if not isinstance(content, dict) or not isinstance(made_with, dict):
        raise InputError("content and made_with: expected objects")
    text("takes", said.get("takes", ""))
    # The plan's own fields: the folder of takes stands beside them, and the digest covers what is in it.
    expected = {item.name for item in fields(CorpusPlan)} - {"takes"}
    missing, unknown = expected - set(content), set(content) - expected - {"recordings", "takes"}
    if missing or unknown:
        wrong = min(missing or unknown)
        raise InputError(f"content: {quote(wrong)} is {'missing' if missing else 'not known'}")
    counts = CorpusPlan(**{name: content[name] for name in expected})
    if said.get("tested") != counts.tested:
        raise InputError(f"tested: {quote(said.get('tested'))}, expected {counts.tested}")
    if said.get("parameters") != list(NAMES):
        raise InputError("parameters: others than this version has")
    if hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16] != said["plan"]:
        raise InputError(f"content: not that of plan {quote(said['plan'])}")
    recordings = content.get("recordings")
    if not isinstance(recordings, dict) or not all(
        isinstance(each, list) and len(each) == 4 and isinstance(each[1], int) for each in recordings.values()
    ):
        raise InputError("recordings: expected kind, frames, rate and origin by name")
    _check_pools(said.get("pools"))
    if said["format"] not in FORMATS:
        raise InputError(f"format: {quote(said['format'])}, this version reads {READ}")
    if said["format"] > min(FORMATS):
        integers("code_size", said.get("code_size"), 1, 1_000_000, ())
    return Manifest(folder, said, counts, made_with)


def _check_pools(pools: Any) -> None:
    if not isinstance(pools, dict) or set(pools) != set(SPLITS) or not all(isinstance(p, dict) for p in pools.values()):
        raise InputError("pools: expected names of recordings by source, of train and test")
    train, test = ({name for each in pools[split].values() for name in texts("pools", each)} for split in SPLITS)
    if both := train & test:
        raise InputError(f"pools: recording {quote(min(both))} is in train and in test")


def write_template(folder: str | PathLike[str], mean: Surface) -> None:
    """Write the mean neutral skin [mm] to a corpus' folder; InputError if it cannot be written."""
    write_arrays(Path(folder) / TEMPLATE, {"vertices": mean.vertices, "triangles": mean.triangles})


def read_template(folder: str | PathLike[str]) -> Surface:
    """Read the mean neutral skin; InputError names a file that is missing, damaged, or not the one of corpus.json."""
    path, named = Path(folder) / TEMPLATE, read_manifest(folder).said["template"]
    arrays = read_arrays(path, kind="a corpus' template")
    try:
        if set(arrays) != {"vertices", "triangles"}:
            raise InputError(f"expected vertices and triangles, got {quote(', '.join(arrays))}")
        mean = Surface(finite("vertices", arrays["vertices"], (None, 3), most=FARTHEST), arrays["triangles"])
        if not named.startswith(surface_hash(mean)):
            raise InputError(f"not of the mesh that {MANIFEST} names")
        return mean
    except SoftdecaError as error:
        raise InputError(
            f"{path}: not this corpus' template, or damaged ({error}); `softdeca corpus generate` makes it anew"
        ) from None
