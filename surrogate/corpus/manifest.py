"""Two files of every corpus, checked before use: corpus.json, its description, and template.npz, its mean skin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any

from ...lhm.base.checks import finite, text
from ...lhm.base.errors import InputError, SoftdecaError, quote
from ...lhm.base.files.npz import read_arrays, write_arrays
from ...lhm.base.files.text import read_json
from ...lhm.base.mesh import Surface
from .plan import CorpusPlan

MANIFEST = "corpus.json"
TEMPLATE = "template.npz"
FARTHEST = 1e4
"""[mm] Of a vertex, and of how far a shape moves one: ten metres."""
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
    return Manifest(folder, said, counts, made_with)


def write_template(folder: str | PathLike[str], mean: Surface) -> None:
    """Write the mean neutral skin [mm] to a corpus' folder; InputError if it cannot be written."""
    write_arrays(Path(folder) / TEMPLATE, {"vertices": mean.vertices, "triangles": mean.triangles})


def read_template(folder: str | PathLike[str]) -> Surface:
    """Read the mean neutral skin; InputError names the file if it is missing, damaged, or not in millimetres."""
    path = Path(folder) / TEMPLATE
    arrays = read_arrays(path, of="a corpus' template")
    try:
        if set(arrays) != {"vertices", "triangles"}:
            raise InputError(f"expected vertices and triangles, got {quote(', '.join(arrays))}")
        return Surface(finite("vertices", arrays["vertices"], (None, 3), most=FARTHEST), arrays["triangles"])
    except SoftdecaError as error:
        raise InputError(f"{path}: not a corpus' template, or damaged ({error})") from None
