"""Two files of every corpus: corpus.json, its description, and template.npz, its mean skin; checked before use."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from ...lhm.base.checks import finite, integers, text, texts
from ...lhm.base.errors import InputError, SoftdecaError, quote
from ...lhm.base.files.npz import read_arrays, write_arrays
from ...lhm.base.files.text import read_json
from ...lhm.base.mesh import Surface
from .mixture import NAMES
from .people import People
from .plan import SPLITS, CorpusPlan
from .shard import FARTHEST, FORMAT
from .simulate import GENERATOR
from .surface_hash import surface_hash

MANIFEST = "corpus.json"
TEMPLATE = "template.npz"
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


def read_manifest(folder: Path) -> tuple[dict[str, Any], CorpusPlan]:
    """Read the corpus.json of a folder: all that it says, and the plan, whose recordings nobody has looked at.

    Raises InputError where there is none, and names the field that is missing, of another kind or out of its range.
    """
    path = folder / MANIFEST
    if not path.exists():
        raise InputError(f"corpus {folder}: no corpus.json; `softdeca corpus generate` makes one")
    said = read_json(path, "a corpus' description")
    try:
        return said, _check(said)
    except InputError as error:
        raise InputError(f"{path}: damaged, or of no corpus of softdeca ({error}); use another folder") from None


def _check(said: Any) -> CorpusPlan:
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
    given: dict[str, Any] = {"contact": False} | content  # which plans without contact do not say
    missing, unknown = expected - set(given), set(given) - expected - {"recordings", "takes"}
    if missing or unknown:
        wrong = min(missing or unknown)
        raise InputError(f"content: {quote(wrong)} is {'missing' if missing else 'not known'}")
    plan = CorpusPlan(**{name: given[name] for name in expected})
    if said.get("tested") != plan.tested:
        raise InputError(f"tested: {quote(said.get('tested'))}, expected {plan.tested}")
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
    if said["format"] != FORMAT:
        raise InputError(f"format: {quote(said['format'])}, this version reads {FORMAT}")
    integers("code_size", said.get("code_size"), 1, 1_000_000, ())
    return plan


def _check_pools(pools: Any) -> None:
    if not isinstance(pools, dict) or set(pools) != set(SPLITS) or not all(isinstance(p, dict) for p in pools.values()):
        raise InputError("pools: expected names of recordings by source, of train and test")
    train, test = ({name for each in pools[split].values() for name in texts("pools", each)} for split in SPLITS)
    if both := train & test:
        raise InputError(f"pools: recording {quote(min(both))} is in train and in test")


def write_template(folder: Path, mean: Surface) -> None:
    """Write the mean neutral skin [mm] to a corpus' folder; InputError if it cannot be written."""
    write_arrays(folder / TEMPLATE, {"vertices": mean.vertices, "triangles": mean.triangles})


def read_template(folder: Path, named: str) -> Surface:
    """Read the mean neutral skin; InputError for a file that is missing, damaged, or not the one `named`."""
    path = folder / TEMPLATE
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
