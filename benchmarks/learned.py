"""The study's surrogate: corpus, training and test, each kept in a folder and used again by the next run."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from ..lhm import fit_head
from ..lhm.progress import OnProgress
from ..surrogate.checkpoint import Checkpoint
from ..surrogate.corpus.folder import Corpus
from ..surrogate.corpus.person import OfSpace
from ..surrogate.corpus.plan import PRESETS
from ..surrogate.evaluate import evaluate
from ..surrogate.runtime import Surrogate, default_path
from ..surrogate.samples import samples_of
from ..surrogate.schedule import processors, schedule
from ..surrogate.train import STUDY as TRAINING
from ..surrogate.train import train

PLAN = PRESETS["study"]


def study(space, template, folder: Path, progress: OnProgress) -> tuple[dict, Surrogate]:
    """Make what is missing of corpus and checkpoint, test the surrogate; return figures for the results file, and it.

    The default space's checkpoint also becomes the one that `Surrogate.load()` finds.
    """
    people = OfSpace(space, space.mean, partial(fit_head, template))
    corpus = Corpus(folder / f"corpus-{space.name}-{template.digest}-{PLAN.digest}", PLAN, people)
    status = corpus.generate(on=schedule(min(2, processors())), on_progress=progress)
    training = samples_of(corpus.folder, "train")
    checkpoint = _trained(corpus, training, progress)
    if space.name == "anny":
        checkpoint.save(default_path())
    surrogate = Surrogate(checkpoint)
    result = evaluate(
        surrogate,
        samples_of(corpus.folder, "test"),
        training,
        expressions=space.expression_deltas(np.zeros(space.code_size)),
    )
    summary = checkpoint.summary
    return {
        "training_frames": summary.frames,
        "training_identities": summary.identities,
        "training_seconds": summary.seconds,
        "corpus": {
            "plan": asdict(PLAN),
            "accepted": status.accepted["statics"],
            "rejected": [
                {"identity": r.identity, "frame": r.row, "reason": r.reason}
                for r in status.rejected
                if r.table == "statics"
            ],
        },
        "test": asdict(result) | {"gain": result.gain},
        "bind_ms": result.bind_ms,
        "frame_ms": result.frame_ms,
        "blend_ms": result.blend_ms,
        "history": [asdict(point) for point in summary.history],
    }, surrogate


def _trained(corpus: Corpus, samples, progress: OnProgress) -> Checkpoint:
    key = hashlib.sha256(f"{corpus.owner} {TRAINING} {len(samples)}".encode()).hexdigest()[:12]
    path = corpus.folder / f"surrogate-{key}.npz"
    if path.is_file():
        return Checkpoint.load(path)
    checkpoint = train(samples, TRAINING, state=corpus.folder / f"training-{key}.pt", on_progress=progress)
    checkpoint.save(path)
    return checkpoint
