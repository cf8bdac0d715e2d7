"""Surrogates and their rivals on a corpus' test people: tables, error against cost, and when training has paid."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..animation import plots
from ..lhm.base.errors import InputError
from ..lhm.base.files.atomic import replaced
from ..lhm.base.progress import OnProgress
from ..lhm.base.provenance import describe_machine
from ..surrogate import Surrogate
from ..surrogate.corpus.folder import known_plan
from ..surrogate.corpus.manifest import OWNER, read_manifest
from ..surrogate.corpus.people import people_of
from ..surrogate.corpus.plan import Split
from ..surrogate.corpus.reading import Faces
from ..surrogate.evaluate import ALL, Score, evaluate
from ..surrogate.evaluate_dynamic import evaluate_dynamic, evaluate_sequences
from ..surrogate.evaluate_references import evaluate_references
from ..surrogate.generalisation import evaluate_generalisation
from ..surrogate.heads import BindCosts, Heads, measure_binds
from ..surrogate.methods import BakedShapes, Blendshapes, BonesCarried, CoarsePD, Derivatives, Method, NetworkMethod
from ..surrogate.networks.responses import LearnedResponses
from ..surrogate.networks.ridge import Ridge
from ..surrogate.networks.weights import Weights
from ..surrogate.ruler import MOVES
from ..surrogate.runtime import SHIPPED
from ..surrogate.schedule import schedule
from . import corpus_size
from .beyond import beyond
from .breakeven import Breakeven, breakeven
from .corpus_size import errors_over_size
from .harness.study import Table
from .harness.tables import markdown
from .surrogate_frames import frames_png
from .surrogate_gates import BLENDSHAPES, CARRIED, HYBRID, LINEARISED, NETWORK, SETTLED, defeats

ITERATIONS = (1, 5, 20)
"""Of projective dynamics stopped early."""
READY: Mapping[str, Callable[[Weights, Heads], Method]] = {
    NETWORK: lambda weights, heads: NetworkMethod(weights),
    HYBRID: lambda weights, heads: NetworkMethod(weights, exact=True),
    LINEARISED: lambda weights, heads: Derivatives(),
    SETTLED: lambda weights, heads: Derivatives(responses=False),
    CARRIED: lambda weights, heads: BonesCarried(heads),
    BLENDSHAPES: lambda weights, heads: Blendshapes(),
}
"""What needs no fit, by name."""
COSTED = 5
"""Faces, spread over the test, on which the seconds of binds by simulation are measured."""
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
    people: str = "test",
    external: Path | None = None,
    simulated: int = 0,
    generalisation: int | None = None,
    workers: int = 1,
    curve: Sequence[Path] = (),
) -> tuple[list[Score], list[Path]]:
    """Scores of all methods, and the files written.

    On the test people of a corpus, or on "all" where training has seen none: static frames, and by what needs no fit,
    sequences where there are some and what FEniCSx says of frames; on all people of an `external` one static frames,
    of kind EXTERNAL, and sequences. On so many of the test faces as `simulated` says, rivals that simulate are scored
    too, of kind "N faces", which needs people whose heads can be fitted, and the default people's network on parameters
    that it has not seen. On so many pairs of people as `generalisation` says they are scored by what is unseen,
    simulated by so many `workers`. `curve`: weights by `train --share`, see `corpus_size`.
    """
    network, split = Surrogate.load(surrogate), split_of(people)
    test, heads = faces_of(corpus, split, partial, network), Heads.of_corpus(corpus, progress)
    training = Faces(corpus, "train", partial=partial) if rivals or curve else None
    grown = errors_over_size(training, curve, test, heads, progress) if training is not None and curve else []
    elsewhere = None if external is None else faces_of(external, None, partial, network)
    ready = ready_methods(network.weights, heads)
    counts = read_manifest(corpus).counts
    costs = bind_costs(heads, test, progress)
    scores = evaluate(ready, test, heads, costs=costs, on_progress=progress)
    if training is not None and rivals:
        fitted = [make() for make in learning().values()]
        scores += evaluate(fitted, test, heads, training, on_progress=progress)
        if counts.sequences:
            from ..surrogate.networks.snp import SubspacePhysics

            scores.append(evaluate_sequences(SubspacePhysics(), corpus, heads, partial=partial, on_progress=progress))
    known = network.weights.looseness
    if counts.sequences and known is not None:
        scores += evaluate_dynamic(ready, corpus, split, heads, known, partial=partial, on_progress=progress)
    if counts.references:
        scores += evaluate_references(ready, corpus, split, heads, partial=partial, on_progress=progress)
    if external is not None and elsewhere is not None:
        scores += _elsewhere(network, external, elsewhere, costs, partial, progress)
    if simulated:
        scores += _beside_simulation(ready, test, heads, simulated, costs, progress)
        scores += beyond(network, progress) if network.space == "anny" else []
    if generalisation is not None:
        scores += _by_what_is_unseen(network, corpus, out, generalisation, workers, costs, progress)
    paid = None if split is None else breakeven(corpus, network.weights.note, scores[0])
    written = [out / "scores.json", out / "scores.md", out / "cost.png", out / "frames.png"]
    with replaced(written[0]) as path:
        found = provenance(corpus, network.weights, test) | {
            "options": _options(
                surrogate,
                {"corpus": corpus, "external": external},
                simulated=simulated,
                generalisation=generalisation,
            ),
            "bind_costs": None if costs is None else asdict(costs),
            "scores": [asdict(score) for score in scores],
            "breakeven": None if paid is None else asdict(paid),
        }
        path.write_text(json.dumps(found | ({"curve": [asdict(one) for one in grown]} if grown else {}), indent=1))
    with replaced(written[1]) as path:
        parts = [told_first(scores), markdown(table(scores)), "" if paid is None else told(paid)]
        parts.append(markdown(corpus_size.table(grown)) if grown else "")
        path.write_text("\n".join(part for part in parts if part))
    with replaced(written[2]) as path:
        path.write_bytes(plots.draw_costs(plotted(scores)))
    with replaced(written[3]) as path:
        path.write_bytes(frames_png(corpus, network.weights, heads, split=split, partial=partial, progress=progress))
    if grown:
        written.append(out / "curve.png")
        with replaced(written[-1]) as path:
            path.write_bytes(corpus_size.picture(grown))
    return scores, written


def split_of(people: str) -> Split | None:
    """The split that "test", or "all", names; InputError for another word."""
    if people not in ("test", "all"):
        raise InputError(f"people {people!r}: there are test, all")
    return None if people == "all" else "test"


def ready_methods(weights: Weights, heads: Heads) -> list[Method]:
    """Make each of READY."""
    return [make(weights, heads) for make in READY.values()]


def bind_costs(heads: Heads, test: Faces, progress: OnProgress, count: int = COSTED) -> BindCosts | None:
    """Measure binds on `count` faces, spread over the test; None where nobody fits heads."""
    try:
        _ = heads.people
    except InputError:
        return None
    chosen = np.unique(np.linspace(0, len(test) - 1, count).round().astype(int))
    return measure_binds(heads, [test.face(int(k)) for k in chosen], progress)


def provenance(corpus: Path, weights: Weights, test: Faces) -> dict:
    """Tell machine, commit and versions, the corpus with its seed, and what the network learned from."""
    manifest = read_manifest(corpus)
    return {
        "machine": describe_machine(),
        "corpus": {name: manifest.said[name] for name in OWNER}
        | {"seed": manifest.counts.seed, "made_with": dict(manifest.made_with)},
        "people": len(np.unique(test.groups[:, 0])),
        "faces": len(test),
        "trained_on": asdict(weights.note),
    }


def plotted(scores: Sequence[Score]) -> list[Score]:
    """The scores over all frames whose costs are known."""
    return [s for s in scores if s.kind == ALL and s.bind_ms is not None and s.frame_ms is not None]


def told_first(scores: Sequence[Score]) -> str:
    """Say where the network loses to a trivial rival; empty where it does not."""
    lost = defeats(scores)
    if not lost:
        return ""
    said = "; ".join(
        f"{kind}: network {100 * own:.1f} %, {rival} {100 * other:.1f} %" for kind, rival, own, other in lost
    )
    return f"The network loses to a rival without learning on: {said}.\n"


def _elsewhere(
    network: Surrogate, external: Path, faces: Faces, costs: BindCosts | None, partial: bool, progress: OnProgress
) -> list[Score]:
    """All methods on the people of another corpus: static frames, and sequences."""
    heads = Heads.of_corpus(external, progress)
    ready, known = ready_methods(network.weights, heads), network.weights.looseness
    scores = evaluate(ready, faces, heads, costs=costs, on_progress=progress)
    found = [replace(score, kind=EXTERNAL) for score in scores if score.kind == ALL]
    if read_manifest(external).counts.sequences and known is not None:
        moving = evaluate_dynamic(ready, external, None, heads, known, partial=partial, on_progress=progress)
        found += [replace(score, kind=f"{EXTERNAL}, {score.kind}") for score in moving]
    return found


def _beside_simulation(
    ready: Sequence[Method], test: Faces, heads: Heads, count: int, costs: BindCosts | None, progress: OnProgress
) -> list[Score]:
    """All methods on some faces, spread over the test, with those that simulate."""
    chosen = np.unique(np.linspace(0, len(test) - 1, count).round().astype(int)).tolist()
    rivals: list[Method] = [CoarsePD(heads, iterations) for iterations in ITERATIONS]
    methods = [*ready, BakedShapes(heads), *rivals]
    found = evaluate(methods, test, heads, chosen=chosen, costs=costs, on_progress=progress)
    return [replace(score, kind=f"{len(chosen)} faces") for score in found if score.kind == ALL]


def _by_what_is_unseen(
    network: Surrogate,
    corpus: Path,
    out: Path,
    count: int,
    workers: int,
    costs: BindCosts | None,
    progress: OnProgress,
) -> list[Score]:
    """All methods on pairs of people that are simulated for it, in OUT/generalisation."""
    plan, made_with = known_plan(corpus)
    people = people_of(made_with["identities"], level=made_with["level"], on_progress=progress)
    ready = ready_methods(network.weights, Heads(people))
    return evaluate_generalisation(
        ready, network.weights, plan, people, out / "generalisation", count=count, on=schedule(workers),
        costs=costs, on_progress=progress,
    )  # fmt: skip


def learning() -> Mapping[str, Callable[[], Method]]:
    """What is fitted to a corpus' training people, by name; most need torch, which is an extra."""
    from ..surrogate.networks.face_wise import FaceWise
    from ..surrogate.networks.softsmpl import SoftSMPL
    from ..surrogate.networks.vertices_only import VerticesOnly

    made: list[Callable[[], Method]] = [LearnedResponses, lambda: Ridge("dimensionless"), lambda: Ridge("raw")]
    made += [lambda: SoftSMPL("small"), lambda: SoftSMPL("large"), VerticesOnly, FaceWise]
    return {make().name: make for make in made}


def faces_of(corpus: Path, split: Split | None, partial: bool, network: Surrogate) -> Faces:
    """The faces of a part of a corpus; InputError where the network is of another mesh."""
    faces = Faces(corpus, split, partial=partial)
    network.weights.check_mesh(faces.mean)
    return faces


def table(scores: Sequence[Score]) -> Table:
    """The scores, a line each."""
    head = ["method", "frames of", "faces", "frames", "share of |T - carried(S)| [%]", "mean [mm]", "95 % [mm]",
            "max [mm]", "moved [mm]", "all vertices [mm]", "fit [s]", "head [ms]", "bind [ms]",
            "frame [ms]"]  # fmt: skip
    lines = [
        (s.method, s.kind, s.faces, s.frames, 100.0 * s.share, s.mean, s.p95, s.largest, s.moved, s.everywhere,
         s.fit_seconds, s.head_ms, s.bind_ms, s.frame_ms)
        for s in scores
    ]  # fmt: skip
    caption = f"Distances to the simulator, over vertices that |T - carried(S)| moves by more than {MOVES:g} mm"
    return Table(caption, head, lines)


def told(paid: Breakeven) -> str:
    """When a corpus and a training have paid, in words."""
    return (
        f"The corpus' training people took {paid.corpus:.0f} s of a core, training {paid.training:.0f} s. A frame of "
        f"the simulator takes {1e3 * paid.simulated_frame:.0f} ms, so the network has paid after {paid.frames:,.0f} "
        f"frames; linearising a face takes {paid.linearised_face:.1f} s, so against that it has after "
        f"{paid.faces:,.0f} faces.\n"
    )
