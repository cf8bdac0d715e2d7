"""A dataset card (README.md) with figures, to publish a corpus."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from ...lhm.base.files.atomic import write_whole
from ...lhm.base.mesh import Floats
from ...lhm.identities import TransferredSpace
from .face import People
from .folder import Corpus, CorpusStatus, shorten_reason
from .mixture import KINDS
from .people import OfSpace
from .shard import ACCEPTED, TABLES, read_arrays_of
from .spheres import Spheres

QUARTERS = (5, 25, 50, 75, 95)
LICENCE = "cc0-1.0"
"""Licence of a corpus of the default head, whose data is CC0 as well, and of spheres."""
OTHER = "other"
OWNERS = "The owners of the heads that it was made of say its licence."


def write_card(
    corpus: Corpus, *, licence: str | None = None, machine: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Write README.md and figures.json into the corpus' folder; return the figures of the card.

    `licence`: by default that of the people. `machine`, where and with what it was made, is kept in figures.json.
    Raises InputError for shards that are damaged, and where a file cannot be written.
    """
    status, licence = corpus.status(), licence or licence_of(corpus.people)
    figures = corpus_figures(corpus, status)
    kept = card_json(corpus, status, figures) | ({"machine": machine} if machine else {})
    write_whole(corpus.folder / "README.md", card_text(corpus, status, figures, licence).encode())
    write_whole(corpus.folder / "figures.json", json.dumps(kept, indent=1).encode())
    return figures


def licence_of(people: People | None) -> str:
    """Return the licence of a corpus of these people; None are not known."""
    free = isinstance(people, OfSpace) and isinstance(people.space, (TransferredSpace, Spheres))
    return LICENCE if free else OTHER


def corpus_figures(corpus: Corpus, status: CorpusStatus) -> dict[str, Any]:
    """Count frames, |T - S| in the face by kind of parameters and by source, iterations, and reasons of rejection."""
    motions: dict[str, list[Floats]] = {}
    iterations: list[Floats] = []
    crossing = 0
    for identity in corpus.people_there():
        corpus.check(identity)
        path = corpus.shard_path(identity)
        names = [f"statics/{name}" for name in ("group", "moved", "status", "recording", "iterations", "crossings")]
        arrays = read_arrays_of(path, "groups/kind", *names)
        good = arrays["statics/status"] == ACCEPTED.encode()
        kinds = arrays["groups/kind"][arrays["statics/group"]]
        sources = np.array([name.partition("/")[0] for name in arrays["statics/recording"].astype(str)], dtype=str)
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


def card_text(corpus: Corpus, status: CorpusStatus, figures: Mapping[str, Any], licence: str) -> str:
    """Write the card in the form of the Hugging Face hub: YAML, then Markdown."""
    template = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True).from_string(
        Path(__file__).with_name("card.md").read_text(encoding="utf-8")
    )
    return template.render(
        plan=corpus.plan,
        space=corpus.space,
        tested=sum(corpus.plan.split(k) == "test" for k in corpus.people_there()),
        status=status,
        licence=licence,
        owners=OWNERS if licence == OTHER else "",
        category=_category(status.asked["statics"] + status.asked["sequences"]),
        version=version("softdeca"),
        tables={name: " ".join((kind.__doc__ or "").split()) for name, kind in TABLES.items()},
        **figures,
    )


def _category(frames: int) -> str:
    for limit, name in ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K")):
        if frames < limit:
            return name
    return "100K<n<1M"


def card_json(corpus: Corpus, status: CorpusStatus, figures: dict[str, Any]) -> dict[str, Any]:
    """Return the card's figures and counts, to be kept where the data is not."""
    report = asdict(status) | {"rejected": len(status.rejected), "damaged": len(status.damaged)}
    return {"plan": json.loads(corpus.plan.to_json()) | {"digest": corpus.plan.digest}, "status": report, **figures}
