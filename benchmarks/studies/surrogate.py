"""The surrogate and its rivals on a corpus' test people: error against cost at bind and per frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path

from ...lhm.errors import InputError
from ...surrogate import Surrogate
from ...surrogate.corpus.folder import read_manifest
from ...surrogate.evaluate import Score, evaluate
from ...surrogate.modal.faces import Faces
from ..harness.gates import above
from ..harness.runner import Row
from ..harness.study import Column, Study, Task, Values
from ..plots import costs_figure, svg
from ..surrogates import GAINED, READY, faces_of, gains, learning

NETWORK_GAIN = 4.0
"""How many times nearer than blendshapes the network has to be."""


@dataclass(frozen=True)
class SurrogateOnCorpus(Study):
    """Static frames of people that training has not seen, by kind of parameters."""

    name = "surrogate"
    heading = "How good is the network on people it has not seen?"
    question = (
        "How far is the surrogate from the simulator on people and parameters it has not seen, beside its rivals?"
    )
    columns = (
        Column("kind", "frames of"),
        Column("frames", "frames"),
        Column("mean", "mean [mm]"),
        Column("p95", "95 % [mm]"),
        Column("largest", "max [mm]"),
        Column("moving", "vertices that move, mean [mm]"),
        Column("share", "mean over that of T = S"),
        Column("fit_seconds", "fit [s]", cost=True),
        Column("bind_ms", "bind [ms]", cost=True),
        Column("frame_ms", "frame [ms]", cost=True),
    )
    note = (
        "Distances of the skin's vertices to the simulator's, T; S are the expressions by blendshapes. Costs are "
        "medians on one thread; of what simulates at bind, without the simulator's part. Vertices that move: by more "
        "than 0.1 mm. Sequences, FEniCSx' answers and rivals that simulate are scored by `softdeca evaluate`."
    )
    timed = True

    corpus: str = field(default="", metadata={"help": "folder of `softdeca corpus generate`"})
    weights: str = field(default="", metadata={"help": "of `softdeca train`  [those that are shipped]"})
    rivals: bool = field(default=False, metadata={"help": "also rivals that learn from its training people: minutes"})
    partial: bool = field(default=False, metadata={"help": "on the people that are there"})
    people: str = field(default="test", metadata={"help": "of the corpus: test, or all, where training has seen none"})

    def tasks(self) -> Sequence[Task]:
        """Each method. Raises InputError where there is no corpus, or the weights are not of its mesh."""
        if not self.corpus:
            raise InputError("--corpus: a folder of `softdeca corpus generate` is needed")
        if self.people not in ("test", "all"):
            raise InputError(f"people {self.people!r}: there are test, all")
        read_manifest(Path(self.corpus))
        names = [*READY, *(learning() if self.rivals else ())]
        return [Task(Path(self.corpus).name, name) for name in names]

    def measure(self, task: Task) -> Values:
        """A method's scores, by kind of parameters."""
        network, test = _tested(self)
        if task.method in READY:
            found = evaluate([READY[task.method](network.weights)], test)
        else:
            training = Faces(Path(self.corpus), "train", partial=self.partial)
            found = evaluate([learning()[task.method]()], test, training)
        return {
            "rows": [asdict(score) for score in found],
            "people": len({identity for identity, _ in test.groups.tolist()}),
            "trained_on": asdict(network.weights.note),
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """What the network has to beat: doing nothing, and with exact derivatives these alone."""
        means = {name: score.mean for name, score in _overall(rows).items()}
        if not set(GAINED) <= set(means):
            return []
        found = gains(means)
        return [
            above("blendshapes' error over the network's, unseen people", found["network_gain"], NETWORK_GAIN),
            above("the linearised simulator's error over that of network and simulator", found["hybrid_gain"], 1.0),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Error and cost of each."""
        said = [
            f"{name} {score.mean:.3f} mm" + (f" ({score.frame_ms:.2f} ms a frame)" if score.frame_ms else "")
            for name, score in _overall(rows).items()
        ]
        people, note = rows[0].values["people"], rows[0].values["trained_on"]
        return (
            f"On {people} people that training ({note['frames']} static frames and the derivatives of {note['faces']} "
            f"faces of {note['people']} people) has not seen, mean distance to the simulator: {'; '.join(said)}."
        )

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Mean error against the cost at bind and per frame."""
        known = [score for score in _overall(rows).values() if score.bind_ms is not None and score.frame_ms is not None]
        return {"Error against cost.": svg(costs_figure(known))} if known else {}


@lru_cache(maxsize=1)
def _tested(study: SurrogateOnCorpus) -> tuple[Surrogate, Faces]:
    network = Surrogate.load(Path(study.weights) if study.weights else None)
    return network, faces_of(Path(study.corpus), None if study.people == "all" else "test", study.partial, network)


def _overall(rows: Sequence[Row]) -> dict[str, Score]:
    """The scores over all frames, by method."""
    scores = [Score(**line) for row in rows for line in row.values["rows"]]
    return {score.method: score for score in scores if score.kind == "all"}
