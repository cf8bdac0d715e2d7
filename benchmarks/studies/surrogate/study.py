"""The surrogate and its rivals on people it has not seen: shares of |T - carried(S)| by kind, and costs."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ....animation.plots import plot_costs, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....lhm.base.progress import silent
from ....surrogate.corpus.manifest import OWNER
from ....surrogate.corpus.plan import PRESETS
from ....surrogate.evaluate import ALL, Score, by_frame, evaluate, measure_frames
from ....surrogate.methods import NETWORK, SNP, Method
from ....surrogate.motion import evaluate_motion, evaluate_played
from ....surrogate.networks.weights import TrainingNote
from ....surrogate.ruler import MOVES
from ....surrogate.trials import SIMULATED, SIMULATOR
from ...harness.study import Column, Row, Study, Table, Task, Values
from .frames import draw_worst_frames
from .gates import describe_defeats, make_gates
from .methods import NetworkExam, list_learners, open_exam, parse_people
from .table_1 import NOTE, TRIVIAL, describe_table, list_trained, tabulate, tabulate_shares, train_and_score

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
        return [Task(case, name) for case, question in self._ask().items() for name in question.methods]

    def measure(self, task: Task) -> Values:
        """Measure a method's scores on the frames of a question, and what is told once of the corpus."""
        question = self._ask()[task.case]
        exam = self._open(self.corpus, self.people)
        if task.case == self._name_table():
            others = self._open(self.external, "all").tested if self.external else None
            scored = train_and_score(exam, task.method, self.hours, others)
        else:
            scored = {"rows": [asdict(score) for score in question.score(question.exam, task.method)]}
        values: Values = {
            **scored,
            "people": len(np.unique(exam.tested.faces.groups[:, 0])),
            "trained_on": asdict(exam.network.weights.note),
            "learned_from": len(exam.network.weights.people),
        }
        if task == Task(self._name_corpus(), NETWORK):
            return {**values, **self._describe(exam)}
        return values

    def _describe(self, exam: NetworkExam) -> Values:
        """Tell what the corpus is, and draw the worst frames."""
        corpus = exam.tested.corpus
        strips = enumerate(draw_worst_frames(exam, silent), start=1)
        return {
            "corpus": {name: corpus.manifest[name] for name in OWNER}
            | {"seed": corpus.plan.seed, "made_with": dict(corpus.made_with)},
            **{f"worst frame of the {number}. worst face": strip for number, strip in strips},
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Bound the shipped network's shares on its own corpus, so that no trivial rival passes; see `make_gates`."""
        scores = _read_scores(rows)
        about = next((row.values["corpus"] for row in rows if "corpus" in row.values), None)
        if self.weights or about is None or about["seed"] != PRESETS["study"].seed:
            return []
        return make_gates(scores)

    def words(self, rows: Sequence[Row]) -> str:
        """Tell first where the network loses, then share and cost of each."""
        scores = _read_scores(rows)
        sentences = [
            f"{score.method} {100 * score.share:.1f} % ({score.mean:.3f} mm)" + _describe_cost(score)
            for score in scores
            if score.kind == ALL
        ]
        table = describe_table([row for row in rows if row.case == self._name_table()])
        if not sentences:
            return table
        people, trainings = rows[0].values["people"], _read_note(rows[0]).trainings
        # An open exam has refused people that the weights name.
        unseen = "that" if rows[0].values.get("learned_from") else "of whom nobody says that"
        frames, faces = sum(note.frames for note in trainings), sum(note.all_faces for note in trainings)
        known = f"{frames:,} static frames and the derivatives of {faces:,} faces"
        parts = (
            describe_defeats(scores).strip(),
            f"{people} people {unseen} training has not seen ({known}). Share left of the motion that bones alone do "
            f"not explain: {'; '.join(sentences)}.",
            table,
        )
        return " ".join(part for part in parts if part)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Lay out the paper's numbers beside ours, and shares by kind of p, where methods were trained."""
        rows = [row for row in rows if row.case == self._name_table()]
        return [tabulate(rows), tabulate_shares(rows)] if rows else []

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw mean error against the cost before the first frame, and per frame."""
        known = [s for s in _read_scores(rows) if s.kind == ALL and s.bind_ms is not None and s.frame_ms is not None]
        return {"Error against cost.": to_svg(plot_costs(known))} if known else {}

    def _name_table(self) -> str:
        """Name the rows of Table 1."""
        return f"{self._name_corpus()}, Table 1"

    def _name_corpus(self) -> str:
        """Name the corpus as rows do: by its folder, or, where that is only digests, by what it is for."""
        name = Path(self.corpus).name
        return "unseen people" if re.fullmatch(r"corpus-[0-9a-f]+-[0-9a-f]+", name) else name

    def _open(self, corpus: str, people: str) -> NetworkExam:
        weights = Path(self.weights) if self.weights else None
        return open_exam(Path(corpus), parse_people(people), weights, self.partial)

    def _ask(self) -> dict[str, Question]:
        """Questions by case: static frames, sequences and FEniCSx' answers of the corpus, another corpus."""
        if not self.corpus:
            raise InputError("--corpus: a folder of `softdeca corpus generate` is needed")
        if not 0.0 <= self.hours <= 1000.0:
            raise InputError(f"--train: expected 0 to 1000 hours, got {self.hours:g}")
        exam, corpus = self._open(self.corpus, self.people), self._name_corpus()
        learners = tuple(list_learners()) if self.rivals else ()
        asked = {corpus: Question(exam, score_static, (*exam.methods, *learners))}
        if exam.has_motion:
            also = (SNP,) if self.rivals else ()
            asked[f"{corpus}, in motion"] = Question(exam, score_moving, (*exam.methods, *also))
        if exam.tested.corpus.plan.references:
            asked[f"{corpus}, against FEniCSx"] = Question(exam, score_referenced, (SIMULATOR, *exam.methods))
        if self.hours:
            names = (*TRIVIAL, NETWORK, *list_trained(exam.tested))
            asked[self._name_table()] = Question(exam, score_referenced, names)
        if self.external:
            other = self._open(self.external, "all")
            case = f"{EXTERNAL}, {other.tested.folder.name}"
            asked[case] = Question(other, score_external, tuple(other.methods))
            if other.has_motion:
                asked[f"{case}, in motion"] = Question(other, score_external_motion, tuple(other.methods))
        return asked


@dataclass(frozen=True, eq=False)
class Question:
    """A question of an exam: how one of the methods is scored, by its name."""

    exam: NetworkExam
    score: Callable[[NetworkExam, str], list[Score]]
    methods: tuple[str, ...]


def score_static(exam: NetworkExam, name: str) -> list[Score]:
    """Score a method on static frames; one that learns is fitted to the corpus' training people first."""
    ready = exam.methods.get(name)
    if ready is not None:
        return evaluate([ready], exam.tested.static(), exam.measure_cost(ready))
    learner, begin = list_learners()[name](None), time.process_time()
    learner.fit(exam.tested.training)
    fitted = time.process_time() - begin
    method = Method(name, learner.bind, learner.needs)
    scores = evaluate([method], exam.tested.static(), exam.measure_cost(method))
    return [replace(score, fit_seconds=fitted) for score in scores]


def score_moving(exam: NetworkExam, name: str) -> list[Score]:
    """Score a method on sequences."""
    if name == SNP:
        from ....surrogate.networks.snp import SubspacePhysics

        return [evaluate_played(SNP, SubspacePhysics(), exam.tested)]
    assert exam.looseness is not None
    return evaluate_motion([exam.methods[name]], exam.tested, exam.looseness)


def score_referenced(exam: NetworkExam, name: str) -> list[Score]:
    """Score a method, or projective dynamics, against FEniCSx, by law."""
    contender = SIMULATED if name == SIMULATOR else by_frame(exam.methods[name])
    table = measure_frames([contender], exam.tested.by_fenicsx())
    return table.scores(table.parts())


def score_external(exam: NetworkExam, name: str) -> list[Score]:
    """Score a method on all static frames of another corpus."""
    return [replace(score, kind=EXTERNAL) for score in score_static(exam, name) if score.kind == ALL]


def score_external_motion(exam: NetworkExam, name: str) -> list[Score]:
    """Score a method on the sequences of another corpus."""
    return [replace(score, kind=f"{EXTERNAL}, {score.kind}") for score in score_moving(exam, name)]


def _read_scores(rows: Sequence[Row]) -> list[Score]:
    return [Score(**line) for row in rows for line in row.values["rows"]]


def _read_note(row: Row) -> TrainingNote:
    return TrainingNote(**row.values["trained_on"])


def _describe_cost(score: Score) -> str:
    if score.bind_ms is None or score.frame_ms is None:
        return ""
    before = 1e-3 * ((score.head_ms or 0.0) + score.bind_ms)
    return f", {before:.2f} s before the first frame, {score.frame_ms:.2f} ms a frame"
