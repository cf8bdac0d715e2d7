"""The surrogate and its rivals on people it has not seen: shares of |T - carried(S)| by kind, and costs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....surrogate import Surrogate
from ....surrogate.corpus.manifest import OWNER
from ....surrogate.corpus.plan import PRESETS
from ....surrogate.methods import HYPERNETWORK, NETWORK, SNP
from ....surrogate.networks.weights import TrainingNote
from ....surrogate.ruler import MOVES
from ....surrogate.trials import SIMULATOR
from ...harness.first_screen import CAPTION, draw_costs
from ...harness.study import Column, Row, Study, Table, Task, Values
from ..person import check_known
from .frames import draw_worst_frames
from .gates import describe_defeats, make_gates
from .methods import NetworkExam, list_learners, open_exam
from .scores import ALL, GROUPS, Line, measure_wait, run_trials, score, score_moved, score_played, score_referenced
from .table_1 import (
    EXTERNAL,
    NOTE,
    TRIVIAL,
    describe_table,
    list_trained,
    tabulate,
    tabulate_shares,
    train,
    train_and_score,
)


@dataclass(frozen=True)
class SurrogateOnCorpus(Study):
    """Frames of people that training has not seen, by kind of parameters and strength of expression.

    Sequences and FEniCSx' answers of the corpus are scored where it has them; the other questions by option.
    """

    name = "surrogate"
    question = "How good is the network on people it has not seen?"
    needs = ("people", "heads", "network", "generator")
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
        f"`softdeca evaluate --help` lists further questions. {NOTE}"
    )
    timed = True

    corpus: str = option("", "folder of `softdeca corpus generate`")
    weights: str = option("", "weights of `softdeca train`; default: the shipped", name="--surrogate")
    people: str = option("test", "people of the corpus: test, or all, where training has seen none")
    partial: bool = option(False, "take the people that an incomplete corpus has")
    rivals: bool = option(False, "also rivals that learn from its training people: minutes")
    hours: float = option(
        0.0, "Table 1: train each of its methods for so many processor hours, and a quarter of them", name="--train"
    )
    external: str = option("", "another corpus to score, such as external:ict:FILE")

    def tasks(self) -> Sequence[Task]:
        """List each question by each method; InputError for no corpus, weights of another mesh, bad options."""
        return [Task(case, name) for case, (names, _) in self._ask().items() for name in names]

    def measure(self, task: Task) -> Values:
        """Measure a method's scores on the frames of a question, and what is told once of the corpus."""
        _, score_method = self._ask()[task.case]
        exam = self._open(self.corpus, self.people)
        weights = (Surrogate.load(HYPERNETWORK) if task.method == HYPERNETWORK else exam.network).weights
        values: dict[str, Any] = {
            **score_method(task.method),
            "people": len(exam.tested.faces.people),
            "trained_on": asdict(weights.note),
            "learned_from": len(weights.people),
        }
        if task != Task(self._name_corpus(), NETWORK):
            return values
        made = exam.tested.corpus
        about = {name: made.manifest[name] for name in OWNER} | {
            "seed": made.plan.seed,
            "made_with": dict(made.made_with),
        }
        strips = enumerate(draw_worst_frames(exam), start=1)
        return values | {"corpus": about} | {f"worst face no. {number}, its worst frame": png for number, png in strips}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Bound the shipped network's shares on its own corpus, so that no trivial rival passes; see `make_gates`."""
        about = next((row.values["corpus"] for row in rows if "corpus" in row.values), None)
        if self.weights or about is None or about["seed"] != PRESETS["study"].seed:
            return []
        return make_gates(_list_scores(rows))

    def words(self, rows: Sequence[Row]) -> str:
        """Tell first where the network loses, then share and cost of each."""
        lines = _list_scores(rows)
        sentences = [
            f"{line['method']} {100 * line['share']:.1f} % ({line['mean']:.3f} mm)" + _describe_cost(line)
            for line in lines
            if line["kind"] == ALL
        ]
        table = describe_table([row for row in rows if row.case == self._name_table()])
        if not sentences:
            return table
        about = rows[0].values
        trainings = TrainingNote(**about["trained_on"]).trainings
        who = "person" if about["people"] == 1 else "people"
        # An open exam has refused people that the weights name.
        unseen = "that" if about.get("learned_from") else "of whom nobody says that"
        frames, faces = sum(note.frames for note in trainings), sum(note.all_faces for note in trainings)
        parts = (
            describe_defeats(lines),
            f"{about['people']} {who} {unseen} training has not seen ({frames:,} static frames and the derivatives "
            f"of {faces:,} faces). Share left of the motion that bones alone do not explain: {'; '.join(sentences)}.",
            table,
        )
        return " ".join(part for part in parts if part)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Lay out the paper's numbers beside ours, and shares by kind of p, where methods were trained."""
        rows = [row for row in rows if row.case == self._name_table()]
        return [tabulate(rows), tabulate_shares(rows)] if rows else []

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw shares against the cost before the first frame, and per frame."""
        costs = {
            line["method"]: (line["share"], 1e-3 * line["frame_ms"], 1e-3 * (_find_wait(line) + line["frame_ms"]))
            for line in _list_scores(rows)
            if line["kind"] == ALL and line["bind_ms"] is not None
        }
        return {CAPTION: draw_costs({"to the simulator": costs})} if costs else {}

    def _name_table(self) -> str:
        """Name the rows of Table 1."""
        return f"{self._name_corpus()}, Table 1"

    def _name_corpus(self) -> str:
        """Name the corpus as rows do: by its folder, or, where that is only digests, by what it is for."""
        name = Path(self.corpus).name
        return "unseen people" if re.fullmatch(r"corpus-[0-9a-f]+-[0-9a-f]+", name) else name

    def _open(self, corpus: str, people: str) -> NetworkExam:
        check_known("people", [people], ("test", "all"))
        weights = Path(self.weights) if self.weights else None
        return open_exam(Path(corpus), None if people == "all" else "test", weights, self.partial)

    def _ask(self) -> dict[str, Question]:
        """Ask, by case, of static frames, sequences and FEniCSx' answers of the corpus, and of another corpus."""
        if not self.corpus:
            raise InputError("--corpus: a folder of `softdeca corpus generate` is needed")
        if not 0.0 <= self.hours <= 1000.0:
            raise InputError(f"--train: expected 0 to 1000 hours, got {self.hours:g}")
        exam, corpus = self._open(self.corpus, self.people), self._name_corpus()
        learners = tuple(list_learners()) if self.rivals else ()
        asked: dict[str, Question] = {corpus: ((*exam.methods, *learners), partial(score_static, exam))}
        if exam.looseness is not None:
            also = (SNP,) if self.rivals else ()
            asked[f"{corpus}, in motion"] = (*exam.methods, *also), partial(score_moving, exam)
        if exam.tested.corpus.plan.references:
            asked[f"{corpus}, against FEniCSx"] = (SIMULATOR, *exam.methods), partial(score_laws, exam)
        other = self._open(self.external, "all") if self.external else None
        if self.hours:
            others = None if other is None else other.tested
            names = (*TRIVIAL, NETWORK, HYPERNETWORK, *list_trained(exam.tested))
            asked[self._name_table()] = names, partial(train_and_score, exam, hours=self.hours, others=others)
        if other is not None:
            case = f"{EXTERNAL}, {other.tested.folder.name}"
            asked[case] = tuple(other.methods), partial(score_static, other, external=True)
            if other.looseness is not None:
                asked[f"{case}, in motion"] = tuple(other.methods), partial(score_moving, other, external=True)
        return asked


Question = tuple[tuple[str, ...], Callable[[str], Values]]
"""Names of methods, and what scores one of them."""


def score_static(exam: NetworkExam, name: str, *, external: bool = False) -> Values:
    """Score a method on static frames; one that learns is fitted to the corpus' training people first.

    external: of another corpus all frames together are one kind.
    """
    method = exam.methods.get(name)
    costs: dict[str, float] = {}
    if method is None:
        method, _, costs = train(name, exam, None)
    names = {ALL: EXTERNAL} if external else {group: group for group in GROUPS}
    lines = score(run_trials(exam.tested.static(), method), names)
    wait = measure_wait(method, exam.tested.spread(2))  # some 5 s
    if wait is not None:
        costs |= {"head_ms": 1e3 * wait.head, "bind_ms": 1e3 * wait.bind}
    return {"rows": [line | costs for line in lines]}


def score_moving(exam: NetworkExam, name: str, *, external: bool = False) -> Values:
    """Score a method on sequences; one that plays them learns those of the training people first."""
    if name == SNP:
        learner, _, cost = train(name, exam, None)
        return {"rows": [line | cost for line in score_played(name, learner, exam.tested)]}
    assert exam.looseness is not None
    lines = score_moved(exam.methods[name], exam.tested, exam.looseness)
    return {"rows": [line | {"kind": f"{EXTERNAL}, {line['kind']}"} for line in lines] if external else lines}


def score_laws(exam: NetworkExam, name: str) -> Values:
    """Score a method, or projective dynamics, against FEniCSx, by law."""
    return {"rows": score_referenced(exam.methods.get(name), exam.tested)}


def _list_scores(rows: Sequence[Row]) -> list[Line]:
    return [line for row in rows for line in row.values["rows"]]


def _find_wait(line: Line) -> float:
    """Time before the first frame [ms]."""
    return (line["head_ms"] or 0.0) + line["bind_ms"]


def _describe_cost(line: Line) -> str:
    if line["bind_ms"] is None:
        return ""
    return f", {1e-3 * _find_wait(line):.2f} s before the first frame, {line['frame_ms']:.2f} ms a frame"
