"""Two files of every corpus: corpus.json, its description with a checksum, and template.npz, its mean skin."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.files.pack import load_packed, save_packed
from ...lhm.base.files.text import read_json
from ...lhm.base.mesh import Surface
from .face import People, surface_hash
from .mixture import NAMES
from .plan import CorpusPlan
from .shard import FORMAT
from .simulate import GENERATOR

MANIFEST = "corpus.json"
TEMPLATE = "template.npz"
OF_TEMPLATE = "softdeca corpus template 1"
OWNER = ("plan", "people", "template", "generator", "format")
"""The fields that name the corpus in each of its shards."""


def describe_corpus(plan: CorpusPlan, people: People, made_with: Mapping[str, Any]) -> dict[str, Any]:
    """Say what corpus.json holds: the fields of OWNER, the plan with its recordings, and how to make the people."""
    return {
        "plan": plan.digest,
        "people": people.name,
        "template": f"{surface_hash(people.mean)}{people.digest}",
        "generator": GENERATOR,
        "format": FORMAT,
        "parameters": list(NAMES),
        "code_size": people.code_size,
        "content": json.loads(plan.to_json()),
        "tested": plan.tested,
        "pools": plan.pools,
        "takes": str(Path(plan.takes).resolve()) if plan.takes else "",
        "made_with": dict(made_with),
    }


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write a description and its checksum; InputError if it cannot be written."""
    write_whole(folder / MANIFEST, json.dumps({**manifest, "checksum": _digest(manifest)}, indent=1).encode())


def read_manifest(folder: Path) -> tuple[dict[str, Any], CorpusPlan]:
    """Read the corpus.json of a folder: all that it says, and the plan, whose recordings nobody has looked at.

    Raises InputError where there is none, and for one that is damaged or of another version.
    """
    path = folder / MANIFEST
    if not path.exists():
        raise InputError(
            f"corpus {folder}: no corpus.json; `softdeca corpus generate` makes one, of its own plan and people"
        )
    manifest = read_json(path, "a corpus' description")
    version = manifest.get("format") if isinstance(manifest, dict) else None
    if version != FORMAT:
        raise InputError(
            f"{path}: of format {quote(version)}, this version reads {FORMAT}; make the corpus anew in another folder"
        )
    if manifest.pop("checksum", "") != _digest(manifest):
        raise InputError(f"{path}: damaged, its content does not match its checksum; use another folder")
    content = {"cells": "tets"} | manifest["content"]  # which plans of tets alone do not say
    return manifest, CorpusPlan(
        **{item.name: content[item.name] for item in fields(CorpusPlan) if item.name != "takes"}
    )


def _digest(manifest: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def write_template(folder: Path, mean: Surface) -> None:
    """Write the mean neutral skin [mm] to a corpus' folder; InputError if it cannot be written."""
    save_packed(folder / TEMPLATE, OF_TEMPLATE, mean)


def read_template(folder: Path, named: str) -> Surface:
    """Read the mean neutral skin; InputError for a file that is missing, damaged, or not the one `named`."""
    mean = _load_template(folder)
    if not named.startswith(surface_hash(mean)):
        raise InputError(f"{folder / TEMPLATE}: of another corpus")
    return mean


def check_template(folder: Path, named: str, else_do: str) -> None:
    """Raise InputError for a whole template that is not the one `named`; a damaged one is made anew."""
    try:
        mean = _load_template(folder)
    except InputError:
        return
    if not named.startswith(surface_hash(mean)):
        raise InputError(f"{folder / TEMPLATE}: of another corpus; {else_do}")


def _load_template(folder: Path) -> Surface:
    path, else_do = folder / TEMPLATE, "`softdeca corpus generate` makes it anew"
    mean: Surface = load_packed(path, OF_TEMPLATE, Surface, what="a corpus' template", else_do=else_do)
    return mean
