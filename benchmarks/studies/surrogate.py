"""The surrogate and its rivals on people it has not seen: shares of |T - carried(S)| by kind, and costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path

from ...animation.plots import plot_costs, to_svg
from ...lhm.base.errors import InputError
from ...lhm.base.progress import silent
from ...surrogate import Surrogate
from ...surrogate.corpus.manifest import read_manifest
from ...surrogate.corpus.reading import Faces
from ...surrogate.evaluate import ALL, Score, evaluate
from ...surrogate.heads import BindCosts, Heads
from ...surrogate.ruler import MOVES
from ..harness.runner import Row
from ..harness.study import Column, Study, Task, Values
from ..surrogate_gates import NETWORK, surrogate_gates
from ..surrogates import READY, bind_costs, faces_of, learning, plotted, split_of, told_first

COSTED = 3
"""Faces on which binds by simulation are measured: some 15 s."""


@dataclass(frozen=True)
class SurrogateOnCorpus(Study):
    """Static frames of people that training has not seen, by kind of parameters and strength of expression."""

    name = "surrogate"
    heading = "How good is the network on people it has not seen?"
    question = (
        "How far is the surrogate from the simulator on people and parameters it has not seen, beside its rivals?"
    )
    columns = (
        Column("kind", "frames of"),
        Column("faces", "faces"),
        Column("frames", "frames"),
        Column("share", "share of |T - carried(S)|"),
        Column("mean", "mean [mm]"),
        Column("p95", "95 % [mm]"),
        Column("largest", "max [mm]"),
        Column("moved", "moved [mm]"),
        Column("everywhere", "all vertices, mean [mm]"),
        Column("fit_seconds", "fit [s]", cost=True),
        Column("head_ms", "head [ms]", cost=True),
        Column("bind_ms", "bind [ms]", cost=True),
        Column("frame_ms", "frame [ms]", cost=True),
    )
    note = (
        "Distances to the simulated skin T. carried(S) are blendshapes S moved along by the bones that p scales. "
        f"Errors and shares are over vertices that |T - carried(S)| moves by more than {MOVES:g} mm. A kind is "
        'named for the one effect in p, whatever the materials; in "materials" no effect differs. Costs are processor '
        "time of one thread: the head once a person, the bind with the simulator's part, one frame at a time. "
        "Sequences, FEniCSx' answers and rivals that simulate are scored by `softdeca evaluate`."
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
        split_of(self.people)
        read_manifest(Path(self.corpus))
        names = [*READY, *(learning() if self.rivals else ())]
        return [Task(Path(self.corpus).name, name) for name in names]

    def measure(self, task: Task) -> Values:
        """A method's scores, by kind of parameters and strength of expression."""
        network, test, heads, costs = _tested(self)
        if task.method in READY:
            found = evaluate([READY[task.method](network.weights, heads)], test, heads, costs=costs)
        else:
            training = Faces(Path(self.corpus), "train", partial=self.partial)
            found = evaluate([learning()[task.method]()], test, heads, training, costs=costs)
        return {
            "rows": [asdict(score) for score in found],
            "people": len({identity for identity, _ in test.groups.tolist()}),
            "trained_on": asdict(network.weights.note),
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Bounds that no trivial rival meets; see `surrogate_gates`."""
        scores = _scores(rows)
        return surrogate_gates(scores) if any(score.method == NETWORK for score in scores) else []

    def words(self, rows: Sequence[Row]) -> str:
        """Where the network loses first, then share and cost of each."""
        scores = _scores(rows)
        said = [
            f"{score.method} {100 * score.share:.1f} % ({score.mean:.3f} mm)" + _cost(score)
            for score in scores
            if score.kind == ALL
        ]
        people, note = rows[0].values["people"], rows[0].values["trained_on"]
        return told_first(scores).replace("\n", " ") + (
            f"{people} people that training has not seen ({note['frames']} static frames and the derivatives of "
            f"{note['faces']} faces of {note['people']} people). Share left of the motion that bones alone do not "
            f"explain: {'; '.join(said)}."
        )

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Mean error against the cost before the first frame, and per frame."""
        known = plotted(_scores(rows))
        return {"Error against cost.": to_svg(plot_costs(known))} if known else {}


@lru_cache(maxsize=1)
def _tested(study: SurrogateOnCorpus) -> tuple[Surrogate, Faces, Heads, BindCosts | None]:
    network, corpus = Surrogate.load(Path(study.weights) if study.weights else None), Path(study.corpus)
    test, heads = faces_of(corpus, split_of(study.people), study.partial, network), Heads.of_corpus(corpus)
    return network, test, heads, bind_costs(heads, test, silent, COSTED)


def _scores(rows: Sequence[Row]) -> list[Score]:
    return [Score(**line) for row in rows for line in row.values["rows"]]


def _cost(score: Score) -> str:
    if score.bind_ms is None or score.frame_ms is None:
        return ""
    before = 1e-3 * ((score.head_ms or 0.0) + score.bind_ms)
    return f", {before:.2f} s before the first frame, {score.frame_ms:.2f} ms a frame"
