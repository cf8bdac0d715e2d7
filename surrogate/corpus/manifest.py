"""corpus.json: what a corpus says it is of, checked field by field before anything uses it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any

from ...lhm.base.checks import text
from ...lhm.base.errors import InputError, shown
from ...lhm.base.files.text import read_json
from .plan import CorpusPlan

MANIFEST = "corpus.json"
OWNER = ("plan", "people", "template", "generator", "format")
"""The fields that name the corpus in each of its shards."""


@dataclass(frozen=True)
class Manifest:
    """What corpus.json says.

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
        return _checked(Path(folder), said)
    except InputError as error:
        raise InputError(f"{path}: damaged, or of no corpus of softdeca ({error}); use another folder") from None


def _checked(folder: Path, said: Any) -> Manifest:
    if not isinstance(said, dict):
        raise InputError(f"expected an object, got {shown(said)}")
    for name in ("plan", "people", "template"):
        text(name, said.get(name))
    for name in ("generator", "format"):
        if isinstance(said.get(name), bool) or not isinstance(said.get(name), (int, str)):
            raise InputError(f"{name}: expected a number, got {shown(said.get(name))}")
    content, made_with = said.get("content"), said.get("made_with", {})
    if not isinstance(content, dict) or not isinstance(made_with, dict):
        raise InputError("content and made_with: expected objects")
    text("takes", said.get("takes", ""))
    counts = CorpusPlan(**_options(content))
    if said.get("tested") != counts.tested:
        raise InputError(f"tested: {shown(said.get('tested'))}, expected {counts.tested}")
    return Manifest(folder, said, counts, made_with)


def _options(content: Mapping[str, Any]) -> dict[str, Any]:
    """The plan's own fields; where takes lie is told beside them, and what is in them by the digest."""
    known = {item.name for item in fields(CorpusPlan)} - {"takes"}
    missing = known - set(content)
    if missing or set(content) - known - {"recordings", "takes"}:
        wrong = min(missing or set(content) - known)
        raise InputError(f"content: {shown(wrong)} is {'missing' if missing else 'not known'}")
    return {name: content[name] for name in known}
