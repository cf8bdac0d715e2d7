"""The study's surrogate on unseen people and parameters, beside rivals that need no training."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path

from ..lhm import fit_head
from ..lhm.progress import OnProgress
from ..surrogate import Surrogate
from ..surrogate.corpus.folder import Corpus
from ..surrogate.corpus.person import OfSpace
from ..surrogate.corpus.plan import PRESETS
from ..surrogate.evaluate import evaluate
from ..surrogate.modal.faces import Faces
from ..surrogate.schedule import processors, schedule
from .surrogates import GAINED, READY, gains

PLAN = PRESETS["study"]


def tested(surrogate: Surrogate, space, template, folder: Path, progress: OnProgress) -> dict:
    """Scores on a small corpus of the study's own, made where it is missing; figures for the results file."""
    people = OfSpace(space, space.mean, partial(fit_head, template), template.digest)
    corpus = Corpus(folder / f"corpus-{space.name}-{template.digest}-{PLAN.digest}", PLAN, people)
    status = corpus.generate(on=schedule(min(2, processors())), on_progress=progress)
    weights, faces = surrogate.weights, Faces(corpus.folder, None)
    scores = evaluate([READY[name](weights) for name in GAINED], faces, on_progress=progress)
    overall = {score.method: score for score in scores if score.kind == "all"}
    return {
        "people": len({identity for identity, _ in faces.groups.tolist()}),
        "faces": len(faces),
        "frames": overall["network"].frames,
        "scores": [asdict(score) for score in scores],
        **gains({name: score.mean for name, score in overall.items()}),
        "rejected": [
            {"identity": r.identity, "frame": r.row, "reason": r.reason}
            for r in status.rejected
            if r.table == "statics"
        ],
        "note": asdict(weights.note),
    }
