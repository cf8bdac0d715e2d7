"""What others need to publish and load a corpus: a dataset card (README.md) with figures, and Croissant metadata."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.files.atomic import replaced
from ...lhm.base.mesh import Floats
from ...lhm.identities import TransferredSpace
from .folder import Corpus, CorpusStatus, shorten_reason
from .mixture import KINDS
from .overlap import sample_overlaps
from .people import OfSpace, People
from .shard import ACCEPTED, TABLES, columns_of, read_arrays_of
from .spheres import Spheres

QUARTERS = (5, 25, 50, 75, 95)
LICENCE = "cc0-1.0"
"""Of a corpus of the default head, whose data is CC0 as well, and of spheres."""
OTHER = "other"
OWNERS = "The owners of the heads that it was made of say its licence."
CROISSANT = "http://mlcommons.org/croissant/1.0"


def write_card(
    corpus: Corpus, *, licence: str | None = None, machine: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Write README.md, figures.json and croissant.json into the corpus' folder; return the figures of the card.

    `licence`: by default that of the people. `machine`, where and with what it was made, is kept in figures.json.
    Raises InputError for shards that are damaged, and where a file cannot be written.
    """
    status, licence = corpus.status(), licence or licence_of(corpus.people)
    figures = corpus_figures(corpus, status)
    with replaced(corpus.folder / "README.md") as temporary:
        temporary.write_text(card_text(corpus, status, figures, licence), encoding="utf-8")
    with replaced(corpus.folder / "figures.json") as temporary:
        temporary.write_text(
            json.dumps(card_json(corpus, status, figures) | ({"machine": machine} if machine else {}), indent=1),
            encoding="utf-8",
        )
    with replaced(corpus.folder / "croissant.json") as temporary:
        temporary.write_text(json.dumps(croissant(corpus, licence), indent=1), encoding="utf-8")
    return figures


def licence_of(people: People | None) -> str:
    """Return the licence of a corpus of these people; None are not known."""
    free = isinstance(people, OfSpace) and isinstance(people.space, (TransferredSpace, Spheres))
    return LICENCE if free else OTHER


def corpus_figures(corpus: Corpus, status: CorpusStatus) -> dict[str, Any]:
    """Count frames, |T - S| in the face by kind of parameters and by source, iterations, and reasons of rejection."""
    motions: dict[str, list[Floats]] = {}
    iterations: list[Floats] = []
    crossing, overlaps = 0, sample_overlaps(corpus)
    for identity in corpus.people_there():
        path = corpus.shard_path(identity)
        names = [f"statics/{name}" for name in ("group", "moved", "status", "recording", "iterations", "crossings")]
        arrays = read_arrays_of(path, corpus.owner, "groups/kind", *names)
        good = arrays["statics/status"] == ACCEPTED.encode()
        kinds = arrays["groups/kind"][arrays["statics/group"]]
        sources = np.char.partition(arrays["statics/recording"].astype(str), "/")[:, 0]
        iterations.append(arrays["statics/iterations"][good].astype(float))
        crossing += int(np.count_nonzero(arrays["statics/crossings"][good]))
        for key, mask in [("all", good), *((kind, good & (kinds == kind.encode())) for kind in KINDS)] + [
            (source, good & (sources == source)) for source in np.unique(sources)
        ]:
            motions.setdefault(str(key), []).append(arrays["statics/moved"][mask])
    gathered = {key: np.concatenate(values) for key, values in motions.items()}
    reasons: dict[str, int] = {}
    for rejection in status.rejected:
        reason = shorten_reason(rejection.reason)
        reasons[reason] = reasons.get(reason, 0) + 1
    return {
        "frames": {key: len(values) for key, values in gathered.items()},
        "mean_mm": {key: _quantiles(values[:, 0]) for key, values in gathered.items()},
        "p95_mm": {key: _quantiles(values[:, 1]) for key, values in gathered.items()},
        "iterations": _quantiles(np.concatenate([np.zeros(0), *iterations])),
        "crossing": crossing,
        "overlaps_mm": {"blendshapes": overlaps[:, 0].tolist(), "skin": overlaps[:, 1].tolist()},
        "rejected": dict(sorted(reasons.items(), key=lambda item: -item[1])),
        "core_hours": sum(status.seconds.values()) / 3600.0 if status.seconds else None,
        "frames_per_core_hour": _rate(status, ("shapes", "fit", "settling", "derivatives", "statics"), "statics"),
        "sequence_frames_per_core_hour": _rate(status, ("sequences",), "sequences"),
        "bytes": status.bytes,
    }


def _rate(status: CorpusStatus, phases: tuple[str, ...], table: str) -> float | None:
    spent = sum(status.seconds.get(phase, 0.0) for phase in phases)
    return status.asked[table] * 3600.0 / spent if spent > 0 else None


def _quantiles(values: Floats) -> list[float]:
    return [float(q) for q in np.percentile(values, QUARTERS)] if len(values) else []


def card_text(corpus: Corpus, status: CorpusStatus, figures: dict[str, Any], licence: str) -> str:
    """Write the card in the form of the Hugging Face hub: YAML, then Markdown."""
    plan = corpus.plan
    tested = sum(plan.split(k) == "test" for k in corpus.people_there())
    head = "\n".join(
        " | ".join(["", key, str(figures["frames"][key]), *(f"{q:.2f}" for q in quantiles), ""]).strip()
        for key, quantiles in figures["p95_mm"].items()
        if quantiles
    )
    counts = "\n".join(f"| {table} | {status.asked[table]} | {status.accepted[table]} |" for table in status.asked)
    rejected = "\n".join(f"| {reason} | {count} |" for reason, count in figures["rejected"].items()) or "| none | 0 |"
    fields_ = "\n".join(
        f"- **{table}**: {' '.join((kind.__doc__ or '').split())} Ranges: {_ranges(kind)}."
        for table, kind in TABLES.items()
    )
    rate = figures["frames_per_core_hour"]
    speed = "not measured" if rate is None else f"{rate:.0f}"
    hours = figures["core_hours"]
    cost = "Core-hours not measured" if hours is None else f"{hours:.2f} core-hours"
    return f"""---
license: {licence}
pretty_name: softdeca corpus {plan.digest}
tags: [physics-based animation, facial animation, finite elements, surrogate model]
size_categories: [{_category(status.asked["statics"] + status.asked["sequences"])}]
---

# softdeca corpus {plan.digest}

Simulated faces after SoftDECA (Wagner, Schwanecke and Botsch, MIG '23): what projective dynamics makes (T) of linear
blendshapes (S) of random people under random materials and effects. Made by softdeca {version("softdeca")} from a plan
of seed {plan.seed}; the same plan gives the same bytes on one kind of machine.

{status.identities_done} of {status.identities} people of `{corpus.space}`, {tested} of them in test. Test
shares no person, no parameter set and no recording with training. Speech and conversations are synthetic.{
        "" if licence != OTHER else f" {OWNERS}"
    }

By default `softdeca train` learns from it a network that is, by name, the paper's z(w) L(p_i, h, π(i)) at vertices, its
ablation, with z = (1, w, N(w)), and no hypernetwork.

| table | frames or rows made | accepted |
|---|---|---|
{counts}

## How far physics moves the face

95 % distance |T - S| in the face of the accepted static frames [mm]: quantiles over frames.

| kind of parameters, or source of the expression | frames | 5 % | 25 % | 50 % | 75 % | 95 % |
|---|---|---|---|---|---|---|
{head}

{"Lids, lips and what lines them are kept from crossing" if plan.contact else "No contact is simulated"}: the skin
wraps of {figures["crossing"]} of {figures["frames"]["all"]} accepted static frames cross themselves somewhere.{
        _describe_overlaps(figures["overlaps_mm"])
    }

## What was rejected

| why | how often |
|---|---|
{rejected}

## Cost

{cost}, {status.bytes / 1e9:.2f} GB; {speed} static frames a core-hour with fit, shapes,
settling and simulation.

## Files

`corpus.json`: plan and splits. `template.npz`: mean skin and triangles. `person-NNNNN.h5`: one person each, arrays
in seven tables, uncompressed; T - S in float16 (rounds by less than 0.008 mm below 16 mm). `person-NNNNN.json`: the
processor seconds that it took, which differ between runs.

{fields_}
"""


def _describe_overlaps(overlaps: Mapping[str, Sequence[float]]) -> str:
    """Say how far lids and lips of sampled frames overlap, before and after."""
    before, after = overlaps["blendshapes"], overlaps["skin"]
    if not before:
        return ""
    counts = [sum(depth > 0.0 for depth in depths) for depths in (before, after)]
    return (
        f" As blendshapes draw the wrap, lids or lips overlap in {counts[0]} of {len(before)} sampled frames, by up\n"
        f"to {max(before):.2f} mm. The skin is finer than the wrap: as it is kept, it overlaps in {counts[1]}, by up\n"
        f"to {max(after):.2f} mm, mostly behind the red of lips."
    )


def _ranges(kind: type) -> str:
    """Join the ranges of a table's columns, which `intact` checks."""
    ranges = {name: column.describe_range() for name, column in columns_of(kind).items()}
    return "; ".join(f"{name} {words}" for name, words in ranges.items() if words)


def _category(frames: int) -> str:
    for limit, name in ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K")):
        if frames < limit:
            return name
    return "100K<n<1M"


def croissant(corpus: Corpus, licence: str) -> dict[str, Any]:
    """Describe every file with its checksum, and the tables' columns, as Croissant 1.0 metadata."""
    names = ("corpus.json", "template.npz", "velocities.npz")
    files = [path for name in names if (path := corpus.folder / name).exists()]
    files += [corpus.shard_path(k) for k in corpus.people_there()]
    forms = {".json": "application/json", ".npz": "application/zip", ".h5": "application/x-hdf5"}
    return {
        "@context": {
            "@language": "en",
            "@vocab": "https://schema.org/",
            "sc": "https://schema.org/",
            "cr": "http://mlcommons.org/croissant/",
            "dct": "http://purl.org/dc/terms/",
            "conformsTo": "dct:conformsTo",
            "fileObject": "cr:fileObject",
            "recordSet": "cr:recordSet",
            "field": "cr:field",
            "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
            "source": "cr:source",
            "sha256": "sc:sha256",
            "fileSet": "cr:fileSet",
            "includes": "cr:includes",
            "extract": "cr:extract",
            "fileProperty": "cr:fileProperty",
            "citeAs": "cr:citeAs",
        },
        "@type": "sc:Dataset",
        "name": f"softdeca-corpus-{corpus.plan.digest}",
        "description": "Simulated faces after SoftDECA: T - S of random people, materials, effects and expressions. "
        f"Each shard has tables of arrays. {_tables()}",
        "conformsTo": CROISSANT,
        "license": f"https://spdx.org/licenses/{licence.upper()}.html" if licence != OTHER else OWNERS,
        "citeAs": "Wagner, Schwanecke, Botsch: SoftDECA. MIG '23. https://doi.org/10.1145/3623264.3624439",
        "datePublished": date.today().isoformat(),
        "version": "1.0.0",
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": path.name,
                "name": path.name,
                "contentUrl": path.name,
                "contentSize": f"{path.stat().st_size} B",
                "encodingFormat": forms[path.suffix],
                "sha256": _sha256(path),
            }
            for path in files
        ]
        + [
            {
                "@type": "cr:FileSet",
                "@id": "shards",
                "name": "shards",
                "description": "One person each",
                "encodingFormat": forms[".h5"],
                "includes": "person-*.h5",
            }
        ],
        # Croissant has no way to name an array of an HDF5 file: its records are the shards, the tables are in words.
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "people",
                "name": "people",
                "field": [
                    {
                        "@type": "cr:Field",
                        "@id": f"people/{name}",
                        "name": name,
                        "dataType": "sc:Text",
                        "source": {"fileSet": {"@id": "shards"}, "extract": {"fileProperty": name}},
                    }
                    for name in ("filename", "content")
                ],
            }
        ],
    }


def _tables() -> str:
    """Join the tables' docstrings and the names of their arrays in one line."""
    described = (
        f"{table} ({', '.join(item.name for item in fields(kind))}): {' '.join((kind.__doc__ or '').split())}"
        for table, kind in TABLES.items()
    )
    return " ".join(described)


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def card_json(corpus: Corpus, status: CorpusStatus, figures: dict[str, Any]) -> dict[str, Any]:
    """Return the card's figures and counts, to be kept where the data is not."""
    report = asdict(status) | {"rejected": len(status.rejected), "damaged": len(status.damaged)}
    return {"plan": json.loads(corpus.plan.to_json()) | {"digest": corpus.plan.digest}, "status": report, **figures}
