"""The surrogate and its rivals on people it has not seen: shares of |T - carried(S)| by kind, and costs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ....animation.plots import plot_costs, subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.limits import FACES, STUDIED_PAIRS
from ....lhm.base.option import option
from ....lhm.base.progress import silent
from ....surrogate.corpus.manifest import OWNER, read_manifest, read_template
from ....surrogate.evaluate import ALL, SIMULATOR, Score, evaluate, evaluate_references
from ....surrogate.evaluate_dynamic import evaluate_dynamic, evaluate_sequences
from ....surrogate.generalisation import evaluate_generalisation
from ....surrogate.methods import BLENDSHAPES, CARRIED, NETWORK, SETTLED, NetworkMethod
from ....surrogate.ruler import MOVES
from ...harness.study import Column, Row, Study, Task, Values
from .beyond import KIND as BEYOND
from .beyond import score_beyond
from .breakeven import Breakeven, compute_breakeven
from .frames import draw_worst_frames
from .gates import describe_defeats, make_gates
from .methods import (
    READY,
    SIMULATE,
    OnCorpus,
    list_learners,
    load_network,
    open_corpus,
    parse_people,
    simulate_test_pairs,
)

SNP = "SNP"
SEEN = 24
"""Training faces, of people that all networks of a curve know, on which each is tried, too."""
CURVE = "over the number of people"
EXTERNAL = "external"
"""Kind of all frames of another corpus, such as ICT-FaceKit's people in the default's triangles."""


@dataclass(frozen=True)
class SurrogateOnCorpus(Study):
    """Frames of people that training has not seen, by kind of parameters and strength of expression.

    Sequences and FEniCSx' answers of the corpus are scored where it has them; the other questions by option.
    """

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
        "`softdeca evaluate --help` lists further questions."
    )
    timed = True

    corpus: str = option("", "folder of `softdeca corpus generate`")
    weights: str = option("", "weights of `softdeca train`; default: the shipped", name="--surrogate")
    people: str = option("test", "of the corpus: test, or all, where training has seen none")
    partial: bool = option(False, "on the people that are there, of a corpus not complete")
    rivals: bool = option(False, "also rivals that learn from its training people: minutes")
    external: str = option("", "another corpus to score, such as external:ict:FILE")
    simulated: int = option(0, "faces for rivals that simulate; with unseen parameters, too: minutes", bound=FACES)
    generalisation: int = option(
        0, "pairs of people, known and unseen, simulated under both's parameters: a minute each", bound=STUDIED_PAIRS
    )
    curve: tuple[str, ...] = option((), "weights of `train --share`: errors over people trained on", name="--curve")

    def tasks(self) -> Sequence[Task]:
        """List each question by each method; InputError for no corpus, weights of another mesh, bad options."""
        return [Task(case, name) for case, (names, _) in self._list_questions().items() for name in names]

    def measure(self, task: Task) -> Values:
        """Measure a method's scores on the frames of a question."""
        scores = self._list_questions()[task.case][1](task.method)
        tested = self._open_corpus()
        values: Values = {}
        if task == Task(self._name_corpus(), NETWORK):
            paid = (
                None
                if tested.split is None
                else compute_breakeven(tested.corpus, tested.network.weights.note, scores[0])
            )
            manifest = read_manifest(tested.corpus)
            values = {
                "corpus": {name: manifest.said[name] for name in OWNER}
                | {"seed": manifest.counts.seed, "made_with": dict(manifest.made_with)},
                "breakeven": None if paid is None else asdict(paid),
                "bind_costs": None if tested.costs is None else asdict(tested.costs),
            }
            strips = enumerate(draw_worst_frames(tested, silent), start=1)
            values = {**values, **{f"worst frame of the {number}. worst face": strip for number, strip in strips}}
        note = (load_network(Path(task.method)) if task.case == CURVE else tested.network).weights.note
        people = len({identity for identity, _ in tested.faces.groups.tolist()})
        return {"rows": [asdict(score) for score in scores], "people": people, "trained_on": asdict(note), **values}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Bound shares so that no trivial rival passes; see `make_gates`."""
        scores = _read_scores(rows)
        if not any(score.method == NETWORK for score in scores):
            return []
        gates = make_gates(scores)
        # Networks of deformation gradients have no offset and responses that the simulator could replace.
        whole = all("form" not in row.values["trained_on"]["config"] for row in rows)
        return gates if whole else gates[:-1]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell first where the network loses, then share and cost of each, and when training has paid."""
        scores = _read_scores(rows)
        sentences = [
            f"{score.method} {100 * score.share:.1f} % ({score.mean:.3f} mm)" + _describe_cost(score)
            for score in scores
            if score.kind == ALL
        ]
        people, note = rows[0].values["people"], rows[0].values["trained_on"]
        paid = [row.values["breakeven"] for row in rows if row.values.get("breakeven")]
        return describe_defeats(scores).replace("\n", " ") + (
            f"{people} people that training has not seen ({note['frames']} static frames and the derivatives of "
            f"{note['faces']} faces of {note['people']} people). Share left of the motion that bones alone do not "
            f"explain: {'; '.join(sentences)}."
        ) + (f" {Breakeven(**paid[0]).sentence}" if paid else "")  # fmt: skip

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw mean error against the cost before the first frame, and per frame; and over the number of people."""
        known = [s for s in _read_scores(rows) if s.kind == ALL and s.bind_ms is not None and s.frame_ms is not None]
        pictures = {"Error against cost.": to_svg(plot_costs(known))} if known else {}
        grown = sorted((row.values["trained_on"]["people"], row) for row in rows if row.case == CURVE)
        if grown:
            figure, axis = subplots(figsize=(6, 3.4))
            people = [count for count, _ in grown]
            for kind, line in (("people that it has not seen", "o-"), ("people that it has learned from", "s--")):
                shares = [
                    100.0 * score.share for _, row in grown for score in _read_scores([row]) if score.kind == kind
                ]
                axis.plot(people, shares, line, label=kind)
            axis.set(xlabel="people in training", ylabel="error [% of |T - carried(S)|]", xscale="log", ylim=(0, None))
            axis.set_xticks(people, [str(count) for count in people])
            axis.minorticks_off()
            axis.legend()
            pictures["Error over the number of people trained on."] = to_svg(figure)
        return pictures

    def _name_corpus(self) -> str:
        """Name the corpus as rows do: by its folder, or, where that is only digests, by what it is for."""
        name = Path(self.corpus).name
        return "unseen people" if re.fullmatch(r"corpus-[0-9a-f]+-[0-9a-f]+", name) else name

    def _open_corpus(self) -> OnCorpus:
        weights = Path(self.weights) if self.weights else None
        return open_corpus(Path(self.corpus), parse_people(self.people), weights, self.partial)

    def _list_questions(self) -> dict[str, tuple[Sequence[str], Callable[[str], list[Score]]]]:
        """Methods, and what scores one of them, by case."""
        if not self.corpus:
            raise InputError("--corpus: a folder of `softdeca corpus generate` is needed")
        tested, corpus = self._open_corpus(), self._name_corpus()
        ready, counts, swings = tested.ready_names, read_manifest(tested.corpus).counts, tested.looseness is not None
        tested.network.weights.check_mesh(read_template(tested.corpus))
        asked: dict[str, tuple[Sequence[str], Callable[[str], list[Score]]]] = {}
        asked[corpus] = (
            [*ready, *(list_learners() if self.rivals else ())],
            lambda name: self._score_static(tested, name),
        )
        if counts.sequences and swings:
            also = [SNP] if self.rivals else []
            asked[f"{corpus}, in motion"] = [*ready, *also], lambda name: self._score_moving(tested, name)
        if counts.references:
            asked[f"{corpus}, against FEniCSx"] = [SIMULATOR, *ready], lambda name: self._score_referenced(tested, name)
        if self.simulated:
            also = [*ready, *SIMULATE]
            asked[f"{corpus}, beside simulation"] = also, lambda name: self._score_beside_simulation(tested, name)
            if tested.network.space == "anny":
                trivial = [NETWORK, CARRIED, SETTLED, BLENDSHAPES]
                asked[BEYOND] = trivial, lambda name: [s for s in _score_beyond(tested.weights) if s.method == name]
        if self.external:
            other = open_corpus(Path(self.external), None, tested.weights, self.partial)
            asked[f"{EXTERNAL}, {other.corpus.name}"] = ready, lambda name: self._score_external(other, name)
            if read_manifest(other.corpus).counts.sequences and swings:
                asked[f"{EXTERNAL}, {other.corpus.name}, in motion"] = (
                    ready,
                    lambda name: [
                        replace(score, kind=f"{EXTERNAL}, {score.kind}") for score in self._score_moving(other, name)
                    ],
                )
        if self.generalisation:
            asked[f"{corpus}, by what is unseen"] = (
                ready,
                lambda name: evaluate_generalisation(
                    [tested.make_ready(name)], simulate_test_pairs(tested, self.generalisation), tested.costs
                ),
            )
        if self.curve:
            if len({load_network(Path(path)).weights.note.people for path in self.curve}) < 2:
                raise InputError("curve: two weights at least, trained on different numbers of people")
            asked[CURVE] = self.curve, lambda path: self._score_curve(tested, path)
        return asked

    def _score_static(self, tested: OnCorpus, name: str) -> list[Score]:
        if name in READY:
            return evaluate([tested.make_ready(name)], tested.faces, tested.heads, costs=tested.costs)
        return evaluate([list_learners()[name]()], tested.faces, tested.heads, tested.training, costs=tested.costs)

    def _score_moving(self, tested: OnCorpus, name: str) -> list[Score]:
        if name == SNP:
            from ....surrogate.networks.snp import SubspacePhysics

            return [evaluate_sequences(SubspacePhysics(), tested.corpus, tested.heads, partial=self.partial)]
        known = tested.looseness
        assert known is not None
        ready = [tested.make_ready(name)]
        return evaluate_dynamic(ready, tested.corpus, tested.split, tested.heads, known, partial=self.partial)

    def _score_referenced(self, tested: OnCorpus, name: str) -> list[Score]:
        ready = [] if name == SIMULATOR else [tested.make_ready(name)]
        scores = evaluate_references(ready, tested.corpus, tested.split, tested.heads, partial=self.partial)
        return [score for score in scores if score.method == name]

    def _score_beside_simulation(self, tested: OnCorpus, name: str) -> list[Score]:
        chosen = tested.spread(self.simulated)
        scores = evaluate([tested.make_ready(name)], tested.faces, tested.heads, chosen=chosen, costs=tested.costs)
        return [replace(score, kind=f"{len(chosen)} faces") for score in scores if score.kind == ALL]

    def _score_external(self, other: OnCorpus, name: str) -> list[Score]:
        scores = evaluate([other.make_ready(name)], other.faces, other.heads, costs=other.costs)
        return [replace(score, kind=EXTERNAL) for score in scores if score.kind == ALL]

    def _score_curve(self, tested: OnCorpus, path: str) -> list[Score]:
        """Score a network of the curve on unseen people, and on people from whom all of the curve have learned.

        Where the share of seen people stays far below that of unseen ones, more people help; where both are level,
        another form would.
        """
        training, notes = tested.training, [load_network(Path(other)).weights.note for other in self.curve]
        network = load_network(Path(path)).weights
        network.check_mesh(training.mean)
        fewest = min(notes, key=lambda note: note.people)
        people = np.unique(training.groups[:, 0])[: fewest.people + len(fewest.held)]
        learned = np.setdiff1d(people, [number for note in notes for number in note.held])
        rows = np.flatnonzero(np.isin(training.groups[:, 0], learned))
        seen = rows[np.unique(np.linspace(0, len(rows) - 1, SEEN).round().astype(int))].tolist()
        method = NetworkMethod(network)
        of_unseen = evaluate([method], tested.faces, tested.heads)[0]
        of_seen = evaluate([method], training, tested.heads, chosen=seen)[0]
        name = f"network of {network.note.people} people"
        return [
            replace(of_unseen, method=name, kind="people that it has not seen"),
            replace(of_seen, method=name, kind="people that it has learned from"),
        ]


@lru_cache(maxsize=1)
def _score_beyond(weights: Path | None) -> list[Score]:
    return score_beyond(load_network(weights), silent)


def _read_scores(rows: Sequence[Row]) -> list[Score]:
    return [Score(**line) for row in rows for line in row.values["rows"]]


def _describe_cost(score: Score) -> str:
    if score.bind_ms is None or score.frame_ms is None:
        return ""
    before = 1e-3 * ((score.head_ms or 0.0) + score.bind_ms)
    return f", {before:.2f} s before the first frame, {score.frame_ms:.2f} ms a frame"
