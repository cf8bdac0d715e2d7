"""Surrogates and their rivals on a corpus' test people: tables, error against cost, and when training has paid."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..lhm.errors import InputError
from ..lhm.files.atomic import replaced
from ..lhm.progress import OnProgress
from ..surrogate import Surrogate
from ..surrogate.corpus.folder import known_plan
from ..surrogate.corpus.manifest import read_manifest
from ..surrogate.corpus.people import people_of
from ..surrogate.corpus.person import OfSpace
from ..surrogate.corpus.plan import Split
from ..surrogate.evaluate import Score, evaluate
from ..surrogate.evaluate_dynamic import evaluate_dynamic, evaluate_sequences
from ..surrogate.evaluate_references import evaluate_references
from ..surrogate.generalisation import evaluate_generalisation
from ..surrogate.modal.faces import Faces
from ..surrogate.modal.weights import ModalWeights
from ..surrogate.rivals import Method
from ..surrogate.rivals.blendshapes import Blendshapes
from ..surrogate.rivals.linearised import Linearised
from ..surrogate.rivals.modal import ModalMethod
from ..surrogate.rivals.responses import LearnedResponses
from ..surrogate.rivals.ridge import Ridge
from ..surrogate.rivals.simulated import BakedShapes, CoarsePD
from ..surrogate.runtime import SHIPPED
from ..surrogate.schedule import schedule
from . import corpus_size, plots
from .beyond import beyond
from .breakeven import Breakeven, breakeven
from .corpus_size import errors_over_size
from .harness.machine import describe
from .harness.study import Table
from .harness.tables import markdown
from .surrogate_frames import frames_png

ITERATIONS = (1, 5, 20)
"""Of projective dynamics stopped early."""
READY: Mapping[str, Callable[[ModalWeights], Method]] = {
    "network": ModalMethod,
    "network + simulator at bind": lambda weights: ModalMethod(weights, exact=True),
    "linearised simulator": lambda weights: Linearised(),
    "settled neutral face + blendshapes": lambda weights: Linearised(responses=False),
    "blendshapes (T = S)": lambda weights: Blendshapes(),
}
"""What needs no fit, by name."""
GAINED = ("network", "network + simulator at bind", "linearised simulator", "blendshapes (T = S)")
EXTERNAL = "external"
"""Kind of all frames of another corpus, such as ICT-FaceKit's people in the default's triangles."""


def _options(surrogate: Path | None, corpora: Mapping[str, Path | None], **counts: int | None) -> dict[str, Any]:
    """What scores are of: each corpus by its plan with seeds, the weights' file by a digest, and counts."""
    plans = {name: None if folder is None else dict(read_manifest(folder).said) for name, folder in corpora.items()}
    digest = hashlib.sha256((surrogate or SHIPPED).read_bytes()).hexdigest()[:16]
    return {"weights": digest, "shipped": surrogate is None} | plans | counts


def compare(
    corpus: Path,
    out: Path,
    *,
    surrogate: Path | None,
    rivals: bool,
    partial: bool,
    progress: OnProgress,
    external: Path | None = None,
    simulated: int = 0,
    generalisation: int | None = None,
    workers: int = 1,
    curve: Sequence[Path] = (),
) -> tuple[list[Score], list[Path]]:
    """Scores of all methods, and the files written.

    On the test people of a corpus: static frames, and by what needs no fit, sequences where there are some and what
    FEniCSx says of frames; on all people of an `external` one static frames, of kind EXTERNAL, and sequences. On so
    many of the test faces as `simulated` says, rivals that simulate are scored too, of kind "N faces", which needs
    people whose heads can be fitted, and the default people's network on parameters that it has not seen. On so many
    pairs of people as `generalisation` says they are scored by what is unseen, simulated by so many `workers`. `curve`:
    weights by `train --share`, see `corpus_size`.
    """
    network = Surrogate.load(surrogate)
    test = faces_of(corpus, "test", partial, network)
    training = Faces(corpus, "train", partial=partial) if rivals or curve else None
    grown = errors_over_size(training, curve, test, progress) if training is not None and curve else []
    elsewhere = None if external is None else faces_of(external, None, partial, network)
    ready = [make(network.weights) for make in READY.values()]
    counts = read_manifest(corpus).counts
    scores = evaluate(ready, test, on_progress=progress)
    if training is not None and rivals:
        fitted = [make() for make in learning().values()]
        scores += evaluate(fitted, test, training, on_progress=progress)
        if counts.sequences:
            from ..surrogate.rivals.snp import SubspacePhysics

            scores.append(evaluate_sequences(SubspacePhysics(), corpus, partial=partial, on_progress=progress))
    known = network.weights.looseness
    if counts.sequences and known is not None:
        scores += evaluate_dynamic(ready, corpus, "test", known, partial=partial, on_progress=progress)
    if counts.references:
        scores += evaluate_references(ready, corpus, "test", partial=partial, on_progress=progress)
    if elsewhere is not None:
        others = evaluate(ready, elsewhere, on_progress=progress)
        scores += [replace(score, kind=EXTERNAL) for score in others if score.kind == "all"]
        if external is not None and read_manifest(external).counts.sequences and known is not None:
            moving = evaluate_dynamic(ready, external, None, known, partial=partial, on_progress=progress)
            scores += [replace(score, kind=f"{EXTERNAL}, {score.kind}") for score in moving]
    if simulated:
        scores += _beside_simulation(ready, test, simulated, progress)
        scores += beyond(network, progress) if network.space == "anny" else []
    if generalisation is not None:
        scores += _by_what_is_unseen(ready, network, corpus, out, generalisation, workers, progress)
    paid = breakeven(corpus, network.weights.note, scores[0])
    written = [out / "scores.json", out / "scores.md", out / "cost.png", out / "frames.png"]
    with replaced(written[0]) as path:
        found = {
            "machine": describe(),
            "options": _options(
                surrogate,
                {"corpus": corpus, "external": external},
                simulated=simulated,
                generalisation=generalisation,
            ),
            "scores": [asdict(score) for score in scores],
            "breakeven": None if paid is None else asdict(paid),
        }
        path.write_text(json.dumps(found | ({"curve": [asdict(one) for one in grown]} if grown else {}), indent=1))
    with replaced(written[1]) as path:
        parts = [markdown(table(scores)), "" if paid is None else told(paid)]
        parts.append(markdown(corpus_size.table(grown)) if grown else "")
        path.write_text("\n".join(part for part in parts if part))
    with replaced(written[2]) as path:
        path.write_bytes(plots.error_against_cost([score for score in scores if score.kind == "all"]))
    with replaced(written[3]) as path:
        path.write_bytes(frames_png(corpus, network.weights, partial=partial, progress=progress))
    if grown:
        written.append(out / "curve.png")
        with replaced(written[-1]) as path:
            path.write_bytes(corpus_size.picture(grown))
    return scores, written


def _beside_simulation(ready: Sequence[Method], test: Faces, count: int, progress: OnProgress) -> list[Score]:
    """All methods on some faces, spread over the test, with those that simulate."""
    people = people_of(test.space)
    if not isinstance(people, OfSpace):
        raise InputError(f"people {test.space!r}: rivals that simulate need an identity space")
    chosen = np.unique(np.linspace(0, len(test) - 1, count).round().astype(int)).tolist()
    rivals: list[Method] = [CoarsePD(people, iterations) for iterations in ITERATIONS]
    found = evaluate([*ready, BakedShapes(people), *rivals], test, chosen=chosen, on_progress=progress)
    return [replace(score, kind=f"{len(chosen)} faces") for score in found if score.kind == "all"]


def _by_what_is_unseen(
    ready: Sequence[Method], network: Surrogate, corpus: Path, out: Path, count: int, workers: int, progress: OnProgress
) -> list[Score]:
    """All methods on pairs of people that are simulated for it, in OUT/generalisation."""
    plan, made_with = known_plan(corpus)
    people = people_of(made_with["identities"], level=made_with["level"], on_progress=progress)
    return evaluate_generalisation(
        ready, network.weights, plan, people, out / "generalisation", count=count, on=schedule(workers),
        on_progress=progress,
    )  # fmt: skip


def learning() -> Mapping[str, Callable[[], Method]]:
    """What is fitted to a corpus' training people, by name; most need torch, which is an extra."""
    from ..surrogate.rivals.face_wise import FaceWise
    from ..surrogate.rivals.softsmpl import SoftSMPL
    from ..surrogate.rivals.vertices_only import VerticesOnly

    made: list[Callable[[], Method]] = [LearnedResponses, lambda: Ridge("dimensionless"), lambda: Ridge("raw")]
    made += [lambda: SoftSMPL("small"), lambda: SoftSMPL("large"), VerticesOnly, FaceWise]
    return {make().name: make for make in made}


def gains(means: Mapping[str, float]) -> dict[str, float]:
    """How many times smaller errors are than without the network: of blendshapes, and of the linearised simulator."""
    return {
        "network_gain": means["blendshapes (T = S)"] / means["network"],
        "hybrid_gain": means["linearised simulator"] / means["network + simulator at bind"],
    }


def faces_of(corpus: Path, split: Split | None, partial: bool, network: Surrogate) -> Faces:
    """The faces of a part of a corpus; InputError where the network is of another mesh."""
    faces = Faces(corpus, split, partial=partial)
    faces.check_mesh(network.weights)
    return faces


def table(scores: Sequence[Score]) -> Table:
    """The scores, a line each."""
    head = ["method", "frames of", "frames", "mean [mm]", "95 % [mm]", "max [mm]", "moving vertices [mm]",
            "share of T = S [%]", "fit [s]", "bind [ms]", "simulator at bind", "frame [ms]"]  # fmt: skip
    lines = [
        (s.method, s.kind, s.frames, s.mean, s.p95, s.largest, s.moving, 100.0 * s.share, s.fit_seconds, s.bind_ms,
         "yes" if s.simulates else "", s.frame_ms)
        for s in scores
    ]  # fmt: skip
    return Table("Distances to the simulator", head, lines)


def told(paid: Breakeven) -> str:
    """When a corpus and a training have paid, in words."""
    return (
        f"The corpus' training people took {paid.corpus:.0f} s of a core, training {paid.training:.0f} s. A frame of "
        f"the simulator takes {1e3 * paid.simulated_frame:.0f} ms, so the network has paid after {paid.frames:,.0f} "
        f"frames; linearising a face takes {paid.linearised_face:.1f} s, so against that it has after "
        f"{paid.faces:,.0f} faces.\n"
    )
