"""The paper's Table 1 on a corpus of one's own: SoftDECA's network, its rivals, and what needs no training."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....surrogate import Surrogate
from ....surrogate.corpus.manifest import OWNER
from ....surrogate.evaluate import ALL, Learns, Score, evaluate
from ....surrogate.methods import (
    BLENDSHAPES,
    CARRIED,
    DERIVATIVES,
    FACE_WISE,
    NETWORK,
    SETTLED,
    SNP,
    SOFTDECA,
    SOFTDECA_OURS,
    SOFTSMPL_GRU,
    SOFTSMPL_LARGE,
    SOFTSMPL_SMALL,
    TRAINED_BY_ENERGY,
    VERTICES_ONLY,
    Method,
    use_network,
)
from ....surrogate.motion import evaluate_motion, evaluate_played
from ....surrogate.networks.weights import Weights
from ....surrogate.trials import DYNAMIC, CorpusTrials
from ...harness.study import Column, Row, Study, Table, Task, Values
from .methods import Contest, list_learners, open_contest, parse_people

GRADIENTS = {
    "paper": SOFTDECA,
    "hyper": SOFTDECA_OURS,
    "softsmpl-small": SOFTSMPL_SMALL,
    "softsmpl-large": SOFTSMPL_LARGE,
    "face-wise": FACE_WISE,
}
"""Labels by the names of `softdeca train --network`."""
TRIVIAL = (BLENDSHAPES, CARRIED, SETTLED, DERIVATIVES)
LEARNED_MOTION = ("paper", "hyper")
"""Networks that learn Eq. 21 where the corpus has sequences."""
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
KINDS = ("static", "static, p over the face", DYNAMIC, "external")


@dataclass(frozen=True)
class Table1(Study):
    """Each method trained, or loaded, and scored once; a task is a method, so that none is trained twice."""

    name = "table-1"
    heading = "The paper's Table 1 on this corpus"
    question = "How do SoftDECA's network, its rivals and its ablations compare on one corpus, by one protocol?"
    needs = ("people", "heads", "network", "generator")
    columns = (
        Column("kind", "frames of"),
        Column("faces", "faces"),
        Column("frames", "frames"),
        Column("everywhere", "all vertices, mean [mm]"),
        Column("share", "share of |T - carried(S)|"),
        Column("mean", "moving vertices, mean [mm]"),
        Column("fit_seconds", "fit, processor [s]", cost=True),
        Column("bind_ms", "bind [ms]", cost=True),
        Column("frame_ms", "frame [ms]", cost=True),
    )
    note = (
        "Static frames are under uniform p, as the paper has them; a network that has one value of p for the whole "
        "face is not scored where p varies. The paper's error is the mean over all vertices. Trainings end by steps, "
        "which are told with each. What a bind takes of the simulator is in the study of people."
    )
    timed = True

    corpus: str = option("", "folder of `softdeca corpus generate`")
    external: str = option("", "another corpus to score, such as external:ict:FILE")
    trained: str = option("", "folder with NETWORK.safetensors of `softdeca train`; what is there is not trained")
    weights: str = option("", "weights of the modal network; default: the shipped", name="--surrogate")
    partial: bool = False
    steps: int = option(0, "steps of each network; 0: those of its own protocol")
    batch: int = 0
    learning_rate: float = 0.0
    recurrence_steps: int = 300
    energy_steps: int = 1000
    energy_faces: int = 16

    def tasks(self) -> Sequence[Task]:
        """Every method; InputError for no corpus, options out of range and a split without frames."""
        if not self.corpus:
            raise InputError("--corpus: a folder of `softdeca corpus generate` is needed")
        for name in ("steps", "batch", "learning_rate", "recurrence_steps", "energy_steps", "energy_faces"):
            if getattr(self, name) < 0:
                raise InputError(f"{name}: expected 0 or more, got {getattr(self, name)}")
        tested = self._open(self.corpus, "test").tested
        if not len(tested.faces):
            raise InputError(f"corpus {self.corpus}: no test people")
        moving = [SOFTSMPL_GRU, SNP] if tested.corpus.plan.sequences else []
        names = [*TRIVIAL, NETWORK, *GRADIENTS.values(), *moving, TRAINED_BY_ENERGY, *list_learners()]
        return [Task(Path(self.corpus).name, name) for name in names]

    def _open(self, corpus: str, people: str) -> Contest:
        weights = Path(self.weights) if self.weights else None
        return open_contest(Path(corpus), parse_people(people), weights, self.partial)

    def measure(self, task: Task) -> Values:
        """Train or load a method, then score it on all kinds of frames that it can answer."""
        contest = self._open(self.corpus, "test")
        tested, corpus = contest.tested, contest.tested.corpus
        about = {
            "corpus": {name: corpus.said[name] for name in OWNER} | {"seed": corpus.plan.seed},
            "people": {
                "train": len(np.unique(tested.training.groups[:, 0])),
                "test": len(np.unique(tested.faces.groups[:, 0])),
            },
        }
        if task.method in (SOFTSMPL_GRU, SNP):
            return about | self._play(task.method, tested)
        method, seconds, said = self._fit(task.method, contest)
        rows = [replace(score, method=task.method, fit_seconds=seconds) for score in self._scores(method, contest)]
        return about | said | {"rows": [asdict(row) for row in rows]}

    def _play(self, name: str, tested: CorpusTrials) -> dict[str, Any]:
        from ....surrogate.networks.snp import SubspacePhysics
        from ....surrogate.networks.softsmpl_gru import SoftSMPLInMotion
        from ....surrogate.networks.trainer import TrainerConfig

        if name == SNP:
            method: Any = SubspacePhysics(self.steps) if self.steps else SubspacePhysics()
        else:
            rate = self.learning_rate or 1e-4
            steps = self.steps or 200_000
            method = SoftSMPLInMotion(TrainerConfig(steps=steps, learning_rate=rate, clip=1.0, validate_every=steps))
        score = evaluate_played(name, method, tested)
        return {"steps": method.steps, "rows": [asdict(score)]}

    def _fit(self, name: str, contest: Contest) -> tuple[Method, float | None, dict[str, Any]]:
        """Return a method that is ready, the processor seconds of its training, and what is said of that."""
        if name in contest.methods:
            return contest.methods[name], None, {}
        begin = time.process_time()
        if name in GRADIENTS.values():
            network = next(key for key, shown in GRADIENTS.items() if shown == name)
            weights = self._weights(network, contest.tested)
            note = {"steps": weights.note.steps, "trained_on": asdict(weights.note)}
            numbers = sum(int(np.prod(array.shape)) for array in weights.network.values())
            return (
                Method(name, use_network(Surrogate(weights))),
                time.process_time() - begin,
                note | {"numbers": numbers},
            )
        from ....surrogate.networks.vertex_network import VertexNetwork

        learner: Learns
        said: dict[str, Any] = {}
        if name == TRAINED_BY_ENERGY:
            from ....surrogate.networks.energy import EnergyTrained, EnergyTraining

            learner = EnergyTrained(EnergyTraining(steps=self.energy_steps, faces=self.energy_faces))
            said = {"steps": self.energy_steps}
        else:
            learner = list_learners()[name]()
            if isinstance(learner, VertexNetwork) and self.steps:
                learner = type(learner)(self.steps)
                said = {"steps": self.steps}
        learner.fit(contest.tested.training)
        return Method(name, learner.bind, learner.needs), time.process_time() - begin, said

    def _weights(self, network: str, tested: CorpusTrials) -> Weights:
        """Load weights, or train them by the options given."""
        from ....surrogate.networks.gradient_training import NETWORKS, train_gradients, with_batch
        from ....surrogate.networks.recurrence_training import RecurrenceTraining, find_mean_pivot, train_recurrence

        path = Path(self.trained or ".") / f"{network}.safetensors"
        if self.trained and path.is_file():
            return Weights.load(path)
        config = NETWORKS[network]
        if network != "hyper":
            # Ours has a rate and a batch of its own.
            config = replace(config, learning_rate=self.learning_rate or config.learning_rate)
            config = replace(config, final_rate=0.5 * config.learning_rate)
            config = with_batch(config, self.batch) if self.batch else config
        config = replace(config, steps=self.steps or config.steps)
        weights = train_gradients(tested.training, config)
        if network in LEARNED_MOTION and tested.corpus.plan.sequences and self.recurrence_steps:
            table = tested.table("sequences", "train")
            moving = RecurrenceTraining(steps=self.recurrence_steps)
            weights = train_recurrence(
                weights, Surrogate(weights).bind_face, table, find_mean_pivot(tested.faces.heads), moving
            )
        if self.trained:
            Path(self.trained).mkdir(parents=True, exist_ok=True)
            weights.save(path)
        return weights

    def _scores(self, method: Method, contest: Contest) -> list[Score]:
        tested, faces = contest.tested, contest.tested.faces
        varies = np.array([bool(faces.coefficients(k)[:, 1:].any()) for k in range(len(faces))])
        has_frames = np.array([bool(len(rows)) for rows in faces.frames_of])
        parts = {KINDS[0]: np.flatnonzero(~varies & has_frames)}
        if method.name not in (SOFTSMPL_SMALL, SOFTSMPL_LARGE):
            parts[KINDS[1]] = np.flatnonzero(varies & has_frames)
        scores = []
        for kind, chosen in parts.items():
            if len(chosen):
                own_scores = evaluate([method], tested.static(chosen.tolist()))
                scores += [replace(score, kind=kind) for score in own_scores if score.kind == ALL]
        if contest.has_motion and method.name != TRAINED_BY_ENERGY:
            assert contest.looseness is not None
            moving = evaluate_motion([method], tested, contest.looseness)
            scores += [score for score in moving if score.kind == DYNAMIC]
        if self.external:
            outside = evaluate([method], self._open(self.external, "all").tested.static())
            scores += [replace(score, kind=KINDS[3]) for score in outside if score.kind == ALL]
        return scores

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """The paper's numbers beside ours, method by method."""
        return [tabulate([row for row in rows if row.done])]

    def words(self, rows: Sequence[Row]) -> str:
        """Say who loses to a rival that learns nothing, and who is nearest."""
        shares = {row.method: share for row in rows if row.done for share in _shares(row, KINDS[0])}
        if SETTLED not in shares:
            return ""
        learned = {name: share for name, share in shares.items() if name not in TRIVIAL}
        lost = [name for name, share in learned.items() if share >= shares[SETTLED]]
        nothing = [name for name, share in learned.items() if share >= shares.get(BLENDSHAPES, np.inf)]
        best = sorted(learned, key=lambda name: learned[name])
        said = f"Static frames under uniform p. {_names(nothing)} lose to {BLENDSHAPES}. " if nothing else ""
        said += f"To {SETTLED} ({100 * shares[SETTLED]:.0f} %) lose {_names(lost)}. "
        order = "; ".join(f"{name} {100 * learned[name]:.1f} %" for name in best)
        linear = f" The derivatives leave {100 * shares[DERIVATIVES]:.1f} %." if DERIVATIVES in shares else ""
        return f"{said}Shares left: {order}.{linear}"


def _shares(row: Row, kind: str) -> list[float]:
    return [line["share"] for line in row.values["rows"] if line["kind"] == kind]


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"


def tabulate(rows: Sequence[Row]) -> Table:
    """Lay Table 1 out: a line per method, the paper's error and time beside ours."""
    shown = (("static", KINDS[0]), ("dynamic", KINDS[2]), ("external", KINDS[3]))
    head = ["method", "steps", "fit [s]"]
    for name, _ in shown:
        head += [f"{name}: paper [mm]", "ours [mm]", "ours [%]"]
    head += ["frame: paper [ms]", "ours [ms]"]
    lines = []
    for row in rows:
        by_kind = {line["kind"]: line for line in row.values["rows"]}
        fit = next((line["fit_seconds"] for line in by_kind.values() if line["fit_seconds"]), None)
        cells: list[Any] = [row.method, row.values.get("steps", ""), "" if fit is None else round(fit)]
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
