"""The paper's Table 1 on a corpus: SoftDECA's network, its rivals and ablations, each trained for the same time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ....lhm.base.errors import InputError
from ....surrogate import Surrogate
from ....surrogate.corpus.reading import Faces
from ....surrogate.evaluate import ALL, Score, by_frame, evaluate, measure_frames
from ....surrogate.methods import (
    BLENDSHAPES,
    CARRIED,
    DERIVATIVES,
    FACE_WISE,
    NETWORK_ALIKE,
    SETTLED,
    SNP,
    SOFTDECA,
    SOFTDECA_ON_TABLES,
    SOFTDECA_OURS,
    SOFTSMPL_GRU,
    SOFTSMPL_LARGE,
    SOFTSMPL_SMALL,
    TABLES,
    VERTICES_ONLY,
    AnyFace,
    Binder,
    Method,
    use_network,
)
from ....surrogate.motion import evaluate_motion, evaluate_played
from ....surrogate.rigs.bound import BoundSurrogate
from ....surrogate.ruler import KINDS
from ....surrogate.trials import AGAINST, DYNAMIC, CorpusTrials
from ...harness.study import Row, Table, Values
from .methods import NetworkExam, list_learners

GRADIENTS = {
    SOFTDECA: "paper",
    SOFTDECA_OURS: "hyper",
    SOFTDECA_ON_TABLES: "hyper",
    SOFTSMPL_SMALL: "softsmpl-small",
    SOFTSMPL_LARGE: "softsmpl-large",
    FACE_WISE: "face-wise",
}
"""Names of `softdeca train --network` by label."""
TRIVIAL = (BLENDSHAPES, CARRIED, SETTLED, DERIVATIVES)
LEARNED_MOTION = (SOFTDECA, SOFTDECA_OURS, SOFTDECA_ON_TABLES)
"""Networks that learn Eq. 21 where the corpus has sequences, in FOR_MOTION of the time."""
FOR_MOTION = 0.1
NOTE = (
    "Static frames of Table 1 are under uniform p, as the paper has them; a network that has one value of p for the "
    "whole face is not scored where p varies. Each method is trained for the same processor time, all that its "
    "training does counted, and once for a quarter of it. SNP and the GRU begin with a sequence's two true skins, "
    "others at their own answer. The floor is what would be left of the responses if L were perfect."
)
SEPARATE = (SOFTDECA, VERTICES_ONLY)
"""Networks of the form z(w) L(p, h, π(i)) alone, whose z has a floor."""
PAPER: Mapping[str, Mapping[str, tuple[float, float]]] = {
    SOFTDECA: {"static": (0.23, 7.45), "dynamic": (0.41, 9.87), "external": (0.44, 7.45)},
    SOFTSMPL_SMALL: {"static": (1.67, 7.62)},
    SOFTSMPL_LARGE: {"static": (0.16, 46.61)},
    SOFTSMPL_GRU: {"dynamic": (0.22, 47.39)},
    SNP: {"dynamic": (0.14, 46.61)},
    FACE_WISE: {"static": (0.17, 34.92)},
    VERTICES_ONLY: {"static": (0.16, 0.72)},
}
"""The paper's Table 1: error [mm] and time of a frame [ms]. Its text has 0.22 mm, and 0.24 mm for SNP, besides."""
STATIC, VARYING, EXTERNAL = "static", "static, p over the face", "external"
EARLY = "after a quarter of the time"
FALLING = 0.05
"""Share of its error that a method loses by four times the time, and is then extra to be still learning."""


def list_trained(tested: CorpusTrials) -> list[str]:
    """List the methods that a corpus' training people can teach, and the table beside them."""
    moving = [SOFTSMPL_GRU, SNP] if tested.corpus.plan.sequences else []
    return [TABLES, NETWORK_ALIKE, *GRADIENTS, *moving, *list_learners()]


def train_and_score(exam: NetworkExam, name: str, hours: float, others: CorpusTrials | None = None) -> Values:
    """Train a method of `list_trained` for some processor hours, and for a quarter of them, and score it.

    Methods that are ready are scored. Hours count all that a training does: solving for tables, steps, validation.
    others: those of another corpus, on whom it is scored, too.
    """
    tested = exam.tested
    about: dict[str, Any] = {"taught": len(np.unique(tested.training.groups[:, 0]))}
    if name in SEPARATE:
        about["floor"] = measure_floor(tested.training, tested.faces, count_latent(name))
    ready = exam.methods | {TABLES: Method(TABLES, use_tables(exam.network))}
    if name in ready:
        return {**about, "rows": [asdict(score) for score in _score(ready[name], exam, others)]}
    if name in (SOFTSMPL_GRU, SNP):
        early, _ = play(name, tested, 0.25 * hours)
        score, steps = play(name, tested, hours)
        return {**about, "steps": steps, "rows": [asdict(score), asdict(replace(early, kind=EARLY))]}
    learner = LEARNERS.get(name, train_rival)
    rows: list[dict[str, Any]] = []
    for share in (1.0, 0.25):
        begin = time.process_time()
        method, told = learner(name, exam, share * hours)
        seconds = time.process_time() - begin
        scores = _score(method, exam, others) if share == 1.0 else score_uniform(method, tested)[:1]
        for score in scores:
            kind = score.kind if share == 1.0 else EARLY
            rows.append(asdict(replace(score, kind=kind, fit_seconds=seconds)))
        about = {**told, **about}
    return {**about, "rows": rows}


def _score(method: Method, exam: NetworkExam, others: CorpusTrials | None) -> Iterator[Score]:
    """Score a method on all kinds of frames that it can answer."""
    tested = exam.tested
    yield from score_uniform(method, tested)
    if method.name not in (SOFTSMPL_SMALL, SOFTSMPL_LARGE):
        yield from score_uniform(method, tested, varying=True)
    if exam.has_motion:
        assert exam.looseness is not None
        moving = evaluate_motion([method], tested, exam.looseness)
        yield from (score for score in moving if score.kind == DYNAMIC)
    if tested.corpus.plan.references:
        table = measure_frames([by_frame(method)], tested.by_fenicsx())
        yield from table.scores(table.parts())
    if others is not None:
        outside = evaluate([method], others.static())
        yield from (replace(score, kind=EXTERNAL) for score in outside if score.kind == ALL)


def describe_table(rows: Sequence[Row]) -> str:
    """Say who loses to a rival that learns nothing, who is nearest, and who is still learning."""
    shares = {row.method: share for row in rows for share in _shares(row, STATIC)}
    if SETTLED not in shares:
        return ""
    learned = {name: share for name, share in shares.items() if name not in TRIVIAL}
    late = {row.method: share for row in rows for share in [*_shares(row, DYNAMIC), *_shares(row, STATIC)]}
    lost = [name for name, share in learned.items() if share >= shares[SETTLED]]
    best = sorted(learned, key=lambda name: learned[name])
    early = {row.method: share for row in rows for share in _shares(row, EARLY)}
    falling = [name for name, share in early.items() if late[name] < (1.0 - FALLING) * share]
    order = "; ".join(f"{name} {100 * learned[name]:.1f} %" for name in best)
    told = f"Worse than {SETTLED} ({100 * shares[SETTLED]:.0f} %): {_names(lost)}. Shares left: {order}."
    return told + (f" Still improving after 4 times the time: {_names(falling)}." if early else "")


def use_tables(network: Surrogate) -> Binder:
    """Return what binds a modal network to first order, as its tables alone have it."""

    def bind(face: AnyFace) -> BoundSurrogate:
        rig = network.bind_face(face)
        if not isinstance(rig, BoundSurrogate):
            raise InputError(f"{TABLES}: a modal network is needed, not a {network.weights.kind} one")
        return rig.to_first_order()

    return bind


Trained = tuple[Method, dict[str, Any]]
"""A method, ready, and what is extra of its training."""


def train_alike(name: str, exam: NetworkExam, hours: float) -> Trained:
    """Train the network itself on the corpus' training people."""
    from ....surrogate.networks.modal_training import ModalTraining, train_modal

    weights = train_modal(exam.tested.training, ModalTraining(hours=hours))
    return Method(name, use_network(Surrogate(weights))), {"steps": weights.note.steps}


def train_form(name: str, exam: NetworkExam, hours: float) -> Trained:
    """Train a network of GRADIENTS for some hours, and where it learns Eq. 21, that in a tenth of them."""
    from ....surrogate.networks.gradient_training import NETWORKS, train_gradients
    from ....surrogate.networks.recurrence_training import RecurrenceTraining, find_mean_pivot, train_recurrence

    tested, start = exam.tested, exam.network.weights if name == SOFTDECA_ON_TABLES else None
    swings = name in LEARNED_MOTION and bool(tested.corpus.plan.sequences)
    still = (1.0 - FOR_MOTION) * hours if swings else hours
    weights = train_gradients(tested.training, replace(NETWORKS[GRADIENTS[name]], hours=still), start=start)
    if swings:
        table, pivot = tested.table("sequences", "train"), find_mean_pivot(tested.faces.heads)
        config = RecurrenceTraining(hours=FOR_MOTION * hours)
        weights = train_recurrence(weights, Surrogate(weights).bind_face, table, pivot, config)
    numbers = sum(int(np.prod(array.shape)) for array in weights.network.values())
    trained = Surrogate(weights)
    return Method(name, use_network(trained), trained.needs), {"steps": weights.note.steps, "numbers": numbers}


def train_rival(name: str, exam: NetworkExam, hours: float) -> Trained:
    """Train one of `list_learners`."""
    learner = list_learners()[name](hours)
    learner.fit(exam.tested.training)
    extra = {"steps": learner.steps} if hasattr(learner, "steps") else {}
    return Method(name, learner.bind, learner.needs), extra


LEARNERS: Mapping[str, Callable[[str, NetworkExam, float], Trained]] = {
    NETWORK_ALIKE: train_alike,
    **dict.fromkeys(GRADIENTS, train_form),
}
"""Trainings of the paper's networks and of ours for some hours, by label; all others are rivals."""


def play(name: str, tested: CorpusTrials, hours: float) -> tuple[Score, int]:
    """Train a method that learns sequences alone, and score it; returns its steps, too."""
    from ....surrogate.networks import snp
    from ....surrogate.networks.softsmpl_gru import SoftSMPLInMotion
    from ....surrogate.networks.trainer import TrainerConfig

    method: Any
    if name == SNP:
        method = snp.SubspacePhysics(replace(snp.TRAINING, hours=hours))
    else:
        method = SoftSMPLInMotion(TrainerConfig(learning_rate=1e-3, clip=1.0, hours=hours))
    score = evaluate_played(name, method, tested)
    return score, method.steps


def score_uniform(method: Method, tested: CorpusTrials, *, varying: bool = False) -> list[Score]:
    """Score a method on static frames under uniform p, all of them first and then by kind of p, or on the others."""
    faces = tested.faces
    varies = np.array([bool(faces.coefficients(k)[:, 1:].any()) for k in range(len(faces))])
    has_frames = np.array([bool(len(rows)) for rows in faces.frames_of])
    chosen = np.flatnonzero((varies == varying) & has_frames)
    if not len(chosen):
        return []
    scores = evaluate([method], tested.static(chosen.tolist()))
    if varying:
        return [replace(score, kind=VARYING) for score in scores if score.kind == ALL]
    kinds = {ALL: STATIC} | {kind: f"{STATIC}, {kind}" for kind in KINDS}
    return [replace(score, kind=kinds[score.kind]) for score in scores if score.kind in kinds]


def count_latent(name: str) -> int:
    """Count the numbers of z in a network of SEPARATE."""
    from ....surrogate.networks import gradient_training, vertices_only

    if name == VERTICES_ONLY:
        return vertices_only.LATENT
    return gradient_training.NETWORKS[GRADIENTS[name]].network.latent


@lru_cache(maxsize=8)
def measure_floor(training: Faces, tested: Faces, latent: int) -> float:
    """Measure what is left of the responses by the best z(w) of `latent` numbers for all faces, were L perfect.

    To first order z = W w; the best W are principal directions of the training faces' responses, each of size one.
    """
    size = training.face(0).responses.shape[0]
    gram = np.zeros((size, size))
    for k in range(len(training)):
        rows = training.face(k).responses.reshape(size, -1).astype(np.float32)
        gram += (rows @ rows.T) / max(float(np.square(rows).sum()), 1e-12)
    kept = np.linalg.eigh(gram)[1][:, ::-1][:, :latent].astype(np.float32)
    left, whole = 0.0, 0.0
    for k in range(len(tested)):
        responses = tested.face(k).responses.astype(np.float32)
        missed = responses - np.tensordot(kept @ kept.T, responses, axes=1)
        left += float(np.linalg.norm(missed, axis=2).mean())
        whole += float(np.linalg.norm(responses, axis=2).mean())
    return left / max(whole, 1e-12)


def _shares(row: Row, kind: str) -> list[float]:
    return [line["share"] for line in row.values["rows"] if line["kind"] == kind]


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"


def tabulate(rows: Sequence[Row]) -> Table:
    """Lay Table 1 out: a line per method, the paper's error and time beside ours."""
    shown = (("static", STATIC), ("dynamic", DYNAMIC), ("external", EXTERNAL))
    head = ["method", "steps", "fit [s]", "floor [%]", "a quarter of the time [%]"]
    for name, _ in shown:
        head += [f"{name}: paper [mm]", "ours [mm]", "ours [%]"]
    head += ["frame: paper [ms]", "ours [ms]"]
    lines = []
    for row in rows:
        by_kind = {line["kind"]: line for line in row.values["rows"]}
        fit = next((line["fit_seconds"] for line in by_kind.values() if line["fit_seconds"]), None)
        cells: list[Any] = [row.method, row.values.get("steps", ""), "" if fit is None else round(fit)]
        cells += [round(100 * row.values["floor"], 1) if "floor" in row.values else ""]
        cells += [round(100 * by_kind[EARLY]["share"], 1) if EARLY in by_kind else ""]
        theirs = PAPER.get(row.method, {})
        for name, kind in shown:
            line = by_kind.get(kind)
            cells += [theirs[name][0] if name in theirs else ""]
            cells += ["", ""] if line is None else [round(line["everywhere"], 3), round(100 * line["share"], 1)]
        frame = next((line["frame_ms"] for line in by_kind.values() if line["frame_ms"]), None)
        first = next(iter(theirs.values()), None)
        cells += ["" if first is None else first[1], "" if frame is None else round(frame, 2)]
        lines.append(cells)
    note = "Errors are means over all vertices; per cent are of |T - carried(S)| over the vertices that it moves."
    return Table("Table 1: the paper's numbers beside ours", head, lines, note)


def tabulate_shares(rows: Sequence[Row]) -> Table:
    """Lay shares [%] out by kind of p, where p varies over the face, and against FEniCSx."""
    by_row = [{line["kind"]: line["share"] for line in row.values["rows"]} for row in rows]
    wanted = [*(f"{STATIC}, {kind}" for kind in KINDS), VARYING, *AGAINST.values()]
    kinds = [kind for kind in wanted if any(kind in shares for shares in by_row)]
    lines = [
        [row.method, *(round(100 * shares[kind], 1) if kind in shares else "" for kind in kinds)]
        for row, shares in zip(rows, by_row, strict=True)
        if shares
    ]
    note = "Against FEniCSx its answer is the truth, by projective dynamics' energy or by its own law."
    return Table("Shares left, by kind of p and against FEniCSx [%]", ["method", *kinds], lines, note)
