"""Error against processor time: solvers of other packages beside ours, on one set of problems, and ours on one face."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from ....animation.plots import to_svg
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.option import option
from ....reference import Parameters, facial_scene
from ....reference.added import NotModelledError, added_laws, added_solvers
from ....surrogate import methods as m
from ...harness.study import Column, Row, Study, Table, Task, Values, at_most
from ..measures import ACCURACY, largest_distance
from ..person import OfPerson
from . import problems
from .curves import plot_curves
from .entrants import Entrant, list_entrants
from .laws import NEO_HOOKEAN, PROJECTIVE, RIGID
from .problems import LINEAR, Case, Problem
from .runs import ACCURACIES, ANSWER, HUNDREDTH, REST, find_budget, run
from .summaries import CASES_OF, judge_claims, rank_solvers, tabulate_best, tabulate_times

CLOCK = 1e-4
"""[s] of a step of the clock at most: set-ups take some milliseconds."""
QUICK_SETTINGS = 2
"""Settings of another package's solver where not all is asked."""
ENERGIES = {"the face's energy (Eq. 15)": PROJECTIVE, "ARAP's energy, same tets": RIGID}
"""Energies of a posed face, each with its law."""


class ErrorOverTime(Study):
    """Problems by solvers and settings; a subclass lists both."""

    timed = True
    columns = (
        Column("law", "law"),
        Column("settings", "settings"),
        Column("budget_s", "budget [s]"),
        Column("warm_up_s", "uncounted run before [s]", cost=True),
        Column("set_up_s", "set-up [s]", cost=True),
        Column("compile_s", "compilation [s]", cost=True),
        Column("solve_s", "solve [s]", cost=True),
        Column("to_tenth_s", "to 0.1 mm [s]", cost=True),
        Column("to_hundredth_s", "to 0.01 mm [s]", cost=True),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("mean_mm", "end, mean [mm]"),
        Column("max_mm", "end, max [mm]"),
        Column("apart_mm", "its minimum to FEniCSx' [mm]"),
        Column("law_mm", "law to neo-Hookean [mm]"),
        Column("element_mm", "element to P1 [mm]"),
        Column("peak_mb", "peak [MB]", cost=True),
        Column("ended", "ended early"),
    )
    budget: float = 0.0

    @abstractmethod
    def list_cases(self) -> Sequence[Case]:
        """List the problems. Raises InputError for options out of range."""

    @abstractmethod
    def make_problem(self, case: str) -> Problem:
        """Make a problem by its name, once per process."""

    @abstractmethod
    def list_entrants(self, case: Case) -> Sequence[Entrant]:
        """List who solves a problem, by which settings."""

    def tasks(self) -> Sequence[Task]:
        """List each problem by each solver, setting and start; InputError for options out of range."""
        return [
            Task(case.name, f"{entrant.solver}; {entrant.setting}; {start}")
            for case in self.list_cases()
            for entrant in self.list_entrants(case)
            for start in (REST, ANSWER)
            if start == REST or (case.start_at_answer and entrant.file)
        ]

    def measure(self, task: Task) -> Values:
        """Run one solver on one problem."""
        title, setting, start = task.method.split("; ")
        (case,) = (each for each in self.list_cases() if each.name == task.case)
        entrant = next(each for each in self.list_entrants(case) if (each.solver, each.setting) == (title, setting))
        problem, law = self.make_problem(task.case), entrant.law or NEO_HOOKEAN
        try:
            answers = problems.list_answers(problem, law, entrant.element)
        except SoftdecaError as without:
            raise NotModelledError(f"no answer to compare with: {without}") from None
        begin = answers[0] if start == ANSWER else problem.vertices
        size = len(problem.tets) * (1 if entrant.element == LINEAR else 8)  # so many linear tets have its nodes
        values = run(entrant, problem, law, answers, self.budget or find_budget(size), begin)
        found = answers[values["answer"] or 0]
        apart = largest_distance(found[problem.skin], answers[0][problem.skin])
        values |= {"start": start, "law": entrant.law or "its own, not given to FEniCSx", "apart_mm": apart}
        return {**values, **self.compare_answers(problem, law, entrant.element)}

    def compare_answers(self, problem: Problem, law: str, element: str) -> Values:
        """Measure what else is to be said of a problem's answers."""
        return {}

    def words(self, rows: Sequence[Row]) -> str:
        """Tell who was first to 0.01 mm on each problem, among solvers of one law."""
        told = "; ".join(rank_solvers(rows))
        return f"First to 0.01 mm of one energy's answer, set-up counted. {told}." if told else ""

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the largest error against processor time with set-up, a line per solver and setting, from rest."""
        figure = plot_curves([(row.case, row.values) for row in rows])
        return {"Error to the solver's own law; defaults as full lines, other settings dotted.": to_svg(figure)}


@dataclass(frozen=True)
class Arena(ErrorOverTime):
    """Each problem by each solver and setting."""

    name = "arena"
    needs = ("people", "heads")
    question = "How do other people's solvers do on the same problems?"
    cheap = "face posed by Eq. 15, 14.5 k tets, PD; default; from rest"
    version = 3
    note = (
        "All solvers have the same tets, held vertices, nodal loads and moduli at rest, and one thread. The error is "
        "the largest distance of a skin vertex to FEniCSx' answer of the solver's own law and element, at a gradient "
        "of 1e-10. Seconds are processor time. Every solver runs a small block before, which is not counted. What "
        "only moves in time loses all velocities whenever its kinetic energy falls. A run ends when its budget is "
        "spent or nothing moves by 1e-6 mm. Settings are the package's defaults first. A solver that starts from the "
        "answer should stay there: where it goes is its bias."
    )

    whole: bool = option(False, "all problems and all settings: an hour and a half")
    budget: float = 0.0
    files: tuple[str, ...] = option(
        (), "a solver's file of your own (docs/arena.md); repeat for several", name="--solver"
    )

    def list_cases(self) -> Sequence[Case]:
        """List the problems; InputError for a budget below zero."""
        if self.budget < 0:
            raise InputError(f"budget: expected at least 0 s, got {self.budget:g}")
        return [case for case in problems.CASES.values() if self.whole or case.quick]

    def make_problem(self, case: str) -> Problem:
        """Make a problem of `problems`."""
        return problems.make(case)

    def list_entrants(self, case: Case) -> Sequence[Entrant]:
        """List solvers and settings: where not all is asked, linear tets, and first settings of other packages."""
        counts: dict[str, int] = {}
        chosen = []
        for entrant in list_entrants(self.files):
            counts[entrant.solver] = counts.get(entrant.solver, 0) + 1
            quick = self.whole or not entrant.file or counts[entrant.solver] <= QUICK_SETTINGS
            if quick and (entrant.element == LINEAR or (self.whole and case.quadratic)):
                chosen.append(entrant)
        return chosen

    def compare_answers(self, problem: Problem, law: str, element: str) -> Values:
        """Measure how far a law's and an element's answers are from the usual ones, and from a closed form."""
        skin, linear = problem.skin, problems.answer(problem, law)
        values = {"law_mm": largest_distance(linear[skin], problems.answer(problem, NEO_HOOKEAN)[skin])}
        if element != LINEAR:
            values["element_mm"] = largest_distance(problems.answer(problem, law, element)[skin], linear[skin])
        if (closed := problem.closed(law)) is not None:
            values["closed_mm"] = largest_distance(linear[skin], closed[skin])
        return values

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check the clock, FEniCSx' closed form, and that solvers have the bar within their own tolerance."""
        gates = []
        steps = [row.values["clock_s"] for row in rows if row.values.get("clock_s") is not None]
        if steps:
            gates.append(at_most("step of the processors' clock, the coarsest [s]", max(steps), CLOCK))
        closed = [row.values["closed_mm"] for row in rows if "closed_mm" in row.values]
        if closed:
            gates.append(at_most("FEniCSx to the bar's closed form [mm]", max(closed), 1e-6))
        bounds = {each.solver: each.tolerance for each in list_entrants(self.files) if np.isfinite(each.tolerance)}
        on_bar = [row.values for row in rows if row.case == "bar" and row.values["start"] == REST]
        for title, bound in bounds.items():
            ends = [row["max_mm"] for row in on_bar if row["solver"] == title and row["max_mm"] is not None]
            if ends:
                gates.append(at_most(f"{title} on the bar, best setting [mm]", min(ends), bound))
        return gates

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate times to accuracies, who leaves the answer, problems of a kind, and claims."""
        biases = [
            (row.case, row.values["solver"], row.values["setting"], row.values["max_mm"], row.values["solve_s"])
            for row in rows
            if row.values["start"] == ANSWER and (row.values["max_mm"] or 0.0) > ACCURACIES[HUNDREDTH]
        ]
        head = ["problem", "solver", "setting", "from the answer [mm]", "after [s]"]
        return [
            tabulate_times(rows),
            Table("Started at the answer, these left it by more than 0.01 mm", head, biases),
            *(tabulate_best(rows, caption, cases) for caption, cases in CASES_OF.items()),
            judge_claims(rows),
        ]


@dataclass(frozen=True)
class WorkPrecision(OfPerson, ErrorOverTime):
    """Expressions of one head: our solvers on its energy, and with libigl on ARAP's."""

    name = "work-precision"
    question = "How long does each method take to be right?"
    cheap = "mouthPucker, ARAP's energy, same tets, FEniCSx"
    version = 4
    note = (
        "Processor time of one thread, after a small block that is not counted. The error is the largest distance of "
        "a vertex to the answer at a gradient of 1e-10: FEniCSx', or projective dynamics' where the energy has two "
        "minima and a solver ends nearer to that. One iteration of PD is one solve with its factor; one of Newton is "
        "a linear system. libigl fits its rotations in float32, hence its own floor. Its handles are what the facial "
        "scene holds and every 16th vertex of the skin wrap."
    )

    expressions: tuple[str, ...] = option(
        ("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker"), "as jawOpen*0.5+cheekPuff; repeat for several"
    )

    def list_cases(self) -> Sequence[Case]:
        """List each expression by each energy; InputError for one that cannot be read."""
        self.check(self.expressions)
        return [Case(name, partial(self.make_problem, name)) for name in self._list_energies()]

    def _list_energies(self) -> dict[str, tuple[str, str]]:
        """Give the expression and the law, by the problem's name."""
        energies = ENERGIES | {f"the face of {law}": law for law in added_laws()}
        return {f"{text}, {energy}": (text, law) for text in self.expressions for energy, law in energies.items()}

    def make_problem(self, case: str) -> Problem:
        """Pose the face of an expression, or pull its handles."""
        return _pose(self, *self._list_energies()[case])

    def list_entrants(self, case: Case) -> Sequence[Entrant]:
        """List solvers of an energy, by linear tets; by a law from a file FEniCSx; and what files have added."""
        _, law = self._list_energies()[case.name]
        every, added = list_entrants(), added_solvers()
        ours = [each for each in every if each.element == LINEAR and each.solver not in (m.SKFEM, *added)]
        if law in ENERGIES.values():
            chosen = [each for each in ours if each.law == law]
        else:
            chosen = [each for each in ours if (each.solver, each.law) == (m.FENICSX, PROJECTIVE)]
        return [replace(each, law=law) for each in (*chosen, *(each for each in every if each.solver in added))]

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that finite elements and projective dynamics end at one answer of each energy."""
        ends = [row.values["max_mm"] for row in rows if row.values["solver"] in (m.PD, m.FENICSX)]
        return [at_most(f"{m.PD} and {m.FENICSX} to the nearest minimum [mm]", max(ends), ACCURACY)] if ends else []

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate times to accuracies, and claims."""
        return [tabulate_times(rows), judge_claims(rows)]


@lru_cache(maxsize=2)
def _pose(study: WorkPrecision, text: str, law: str) -> Problem:
    person = study.person()
    if law == RIGID:
        return problems.pull_handles(person.head, person.shape(text))
    return problems.pose_face(facial_scene(person.head, Parameters(), person.shape(text), cells="tets"))
