"""The study's surrogate: corpus, training and test, each kept in a folder and used again by the next run."""

from __future__ import annotations

import hashlib
import os
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from ..lhm import fit_head
from ..lhm.progress import OnProgress
from ..surrogate.checkpoint import Checkpoint
from ..surrogate.corpus import Corpus
from ..surrogate.evaluate import evaluate
from ..surrogate.plan import STUDY as PLAN
from ..surrogate.runtime import Surrogate, default_path
from ..surrogate.train import STUDY as TRAINING
from ..surrogate.train import train


def study(space, template, folder: Path, progress: OnProgress) -> tuple[dict, Surrogate]:
    """Make what is missing of corpus and checkpoint, test the surrogate; return figures for the results file, and it.

    The default space's checkpoint also becomes the one that `Surrogate.load()` finds.
    """
    corpus = Corpus(folder / f"corpus-{space.name}-{template.digest}-{PLAN.digest}", PLAN, space)
    status = corpus.generate(partial(fit_head, template), workers=min(2, os.cpu_count() or 1), on_progress=progress)
    training = corpus.samples("train")
    checkpoint = _trained(corpus, training, progress)
    if space.name == "anny":
        checkpoint.save(default_path())
    surrogate = Surrogate(checkpoint)
    result = evaluate(
        surrogate, corpus.samples("test"), training, expressions=space.expression_deltas(np.zeros(space.code_size))
    )
    summary = checkpoint.summary
    return {
        "training_frames": summary.frames,
        "training_identities": summary.identities,
        "training_seconds": summary.seconds,
        "corpus": {
            "plan": asdict(PLAN),
            "accepted": status.accepted,
            "rejected": [asdict(rejection) for rejection in status.rejected],
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
