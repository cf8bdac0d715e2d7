"""Surrogates and their rivals on a corpus' test people: table, and error against cost."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from ..lhm.errors import InputError
from ..lhm.files.atomic import replaced
from ..lhm.progress import OnProgress
from ..surrogate import Surrogate
from ..surrogate.evaluate import Score, evaluate
from ..surrogate.modal.faces import Faces
from ..surrogate.rivals import Method
from ..surrogate.rivals.blendshapes import Blendshapes
from ..surrogate.rivals.linearised import Linearised
from ..surrogate.rivals.modal import ModalMethod
from ..surrogate.rivals.responses import LearnedResponses
from ..surrogate.rivals.ridge import Ridge
from ..surrogate.surface_hash import surface_hash
from . import plots


def compare(
    corpus: Path,
    out: Path,
    *,
    surrogate: Path | None,
    rivals: bool,
    partial: bool,
    progress: OnProgress,
) -> tuple[list[Score], list[Path]]:
    """Scores of all methods, and the files written."""
    network = Surrogate.load(surrogate)
    test = Faces(corpus, "test", partial=partial)
    if surface_hash(test.mean) != network.weights.template:
        raise InputError(
            f"weights: of a mean skin of {len(network.weights.mean.vertices)} vertices, not of the corpus'"
        )
    ready: list[Method] = [
        ModalMethod(network.weights),
        ModalMethod(network.weights, exact=True),
        Linearised(),
        Linearised(responses=False),
        Blendshapes(),
    ]
    scores = evaluate(ready, test, on_progress=progress)
    if rivals:
        learning: list[Method] = [LearnedResponses(), Ridge("dimensionless"), Ridge("raw")]
        scores += evaluate(learning, test, Faces(corpus, "train", partial=partial), on_progress=progress)
    written = [out / "scores.json", out / "scores.md", out / "cost.png"]
    with replaced(written[0]) as path:
        path.write_text(json.dumps([asdict(score) for score in scores], indent=1))
    with replaced(written[1]) as path:
        path.write_text(table(scores))
    with replaced(written[2]) as path:
        path.write_bytes(plots.error_against_cost([score for score in scores if score.kind == "all"]))
    return scores, written


def table(scores: Sequence[Score]) -> str:
    """The scores as a Markdown table."""
    lines = [
        "| method | parameters | frames | mean [mm] | 95 % [mm] | max [mm] | moving vertices [mm] | share of T = S [%] "
        "| fit [s] | bind [ms] | frame [ms] |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for s in scores:
        bind = f"{s.bind_ms:.0f} + simulator" if s.simulates else f"{s.bind_ms:.0f}"
        lines.append(
            f"| {s.method} | {s.kind} | {s.frames} | {s.mean:.4f} | {s.p95:.3f} | {s.largest:.2f} | {s.moving:.4f} "
            f"| {100.0 * s.share:.1f} | {s.fit_seconds:.0f} | {bind} | {s.frame_ms:.2f} |"
        )
    return "\n".join(lines) + "\n"
