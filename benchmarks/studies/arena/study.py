"""Error against processor time: solvers of other packages beside ours, on one set of problems."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....animation.plots import to_svg
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.option import option
from ....reference.added import NotModelledError
from ...harness.study import Column, Row, Study, Table, Task, Values, at_most
from ..measures import largest_distance
from . import problems
from .curves import Panel, plot_curves
from .entrants import Entrant, list_entrants
from .laws import NEO_HOOKEAN
from .problems import LINEAR
from .runs import ACCURACIES, ANSWER, HUNDREDTH, REST, find_budget, run
from .summaries import CASES_OF, judge_claims, tabulate_best, tabulate_times

CLOCK = 1e-4
"""[s] of a step of the clock at most: set-ups take some milliseconds."""
QUICK_SETTINGS = 2
"""Settings of another package's solver where not all is asked."""


@dataclass(frozen=True)
class Arena(Study):
    """Each problem by each solver and setting."""

    name = "arena"
    heading = "How do other people's solvers do on the same problems?"
    question = (
        "How near to the answer of its own law is each solver after a given processor time, and where does it end?"
    )
    needs = ("people", "heads")
    cheap = "face posed by Eq. 15, 14.5 k tets, PD; default; from rest"
    version = 2
    columns = (
        Column("law", "law"),
        Column("law_mm", "law to neo-Hookean [mm]"),
        Column("element_mm", "element to P1 [mm]"),
        Column("settings", "settings"),
        Column("budget_s", "budget [s]"),
        Column("warm_up_s", "uncounted run before [s]", cost=True),
        Column("set_up_s", "set-up [s]", cost=True),
        Column("compile_s", "compilation [s]", cost=True),
        Column("solve_s", "solve [s]", cost=True),
        Column("to_tenth_s", "to 0.1 mm [s]", cost=True),
        Column("to_hundredth_s", "to 0.01 mm [s]", cost=True),
        Column("mean_mm", "end, mean [mm]"),
        Column("max_mm", "end, max [mm]"),
        Column("peak_mb", "peak [MB]", cost=True),
        Column("ended", "ended early"),
    )
    note = (
        "All solvers have the same tets, held vertices, nodal loads and moduli at rest, and one thread. The error is "
        "the largest distance of a skin vertex to FEniCSx' answer of the solver's own law at a gradient of 1e-10; the "
        "distance of that answer to the neo-Hookean one has its own column. Quadratic tets, and those with a pressure, "
        "have an answer of their own element, and a column likewise. Seconds are processor time. Every solver "
        "runs a small block before, which is not counted; imports, set-up and compilation are told apart. What only "
        "moves in time is brought to rest by setting all velocities to zero whenever the kinetic energy falls. A run "
        "ends when its budget is spent or nothing moves by 1e-6 mm. "
        "newton is made for GPUs, and runs here on its CPU kernels. Settings are the package's defaults first. "
        "A solver that starts from the answer should stay there: where it goes is its bias."
    )
    timed = True

    whole: bool = option(False, "all problems and all settings: an hour and a half")
    budget: float = 0.0
    files: tuple[str, ...] = option(
        (), "a solver's file of your own (docs/arena.md); repeat for several", name="--solver"
    )

    def tasks(self) -> Sequence[Task]:
        """List each problem by each solver, setting and start; InputError for options out of range."""
        if self.budget < 0:
            raise InputError(f"budget: expected at least 0 s, got {self.budget:g}")
        return [
            Task(case.name, f"{entrant.solver}; {entrant.setting}; {start}")
            for case in problems.CASES.values()
            if self.whole or case.quick
            for entrant in self._list_entrants()
            if entrant.element == LINEAR or (self.whole and case.quadratic)
            for start in (REST, ANSWER)
            if start == REST or (case.start_at_answer and entrant.file)
        ]

    def measure(self, task: Task) -> Values:
        """Run one solver on one problem."""
        title, setting, start = task.method.split("; ")
        entrant = next(each for each in self._list_entrants() if (each.solver, each.setting) == (title, setting))
        problem, law = problems.make(task.case), entrant.law or NEO_HOOKEAN
        try:
            linear = problems.answer(task.case, law)
            own = linear if entrant.element == LINEAR else problems.answer(task.case, law, entrant.element)
            neo = problems.answer(task.case, NEO_HOOKEAN)
        except SoftdecaError as without:
            raise NotModelledError(f"no answer to compare with: {without}") from None
        begin = own if start == ANSWER else problem.vertices if problem.begin is None else problem.begin
        size = len(problem.tets) * (1 if entrant.element == LINEAR else 8)  # so many linear tets have its nodes
        budget = self.budget or find_budget(size)
        values = run(entrant, problem, law, {"own": own, "neo": neo}, budget, begin)
        values |= {"start": start, "law": entrant.law or "its own, not given to FEniCSx"}
        skin = problem.skin
        values["law_mm"] = largest_distance(linear[skin], neo[skin])
        if entrant.element != LINEAR:
            values["element_mm"] = largest_distance(own[skin], linear[skin])
        closed = problem.closed(law)
        if closed is not None:
            values["closed_mm"] = largest_distance(own[skin], closed[skin])
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
        bounds = {each.solver: each.tolerance for each in self._list_entrants() if np.isfinite(each.tolerance)}
        for title, bound in bounds.items():
            ends = [
                row.values["floor_mm"]
                for row in rows
                if row.case == "bar" and row.values["solver"] == title and row.values["start"] == REST
                and row.values["max_mm"] is not None
            ]  # fmt: skip
            if ends:
                gates.append(at_most(f"{title} on the bar, best setting [mm]", min(ends), bound))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell who was first to 0.01 mm on each problem, among solvers of one law."""
        sentences = []
        for case in dict.fromkeys(row.case for row in rows):
            times: dict[str, dict[str, float]] = {}
            for row in rows:
                values = row.values
                if row.case == case and values["start"] == REST and values["to_hundredth_s"] is not None:
                    took, among = values["set_up_s"] + values["to_hundredth_s"], times.setdefault(values["law"], {})
                    among[values["solver"]] = min(took, among.get(values["solver"], np.inf))
            for law, among in times.items():
                ranked = sorted(among.items(), key=lambda item: item[1])[:4]
                if len(ranked) > 1:
                    told = ", ".join(f"{title} {seconds:.2g} s" for title, seconds in ranked)
                    sentences.append(f"{case}, {law}: {told}")
        return "First to 0.01 mm of one energy's answer, set-up counted. " + "; ".join(sentences) + "."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate times to accuracies, who leaves the answer, problems of a kind, and claims."""
        biases = [
            (row.case, row.values["solver"], row.values["setting"], row.values["max_mm"], row.values["solve_s"])
            for row in rows
            if row.values["start"] == ANSWER and (row.values["max_mm"] or 0.0) > ACCURACIES[HUNDREDTH]
        ]
        return [
            tabulate_times(rows),
            Table("Started at the answer, these left it by more than 0.01 mm",
                  ["problem", "solver", "setting", "from the answer [mm]", "after [s]"], biases),
            *(tabulate_best(rows, caption, cases) for caption, cases in CASES_OF.items()),
            judge_claims(rows),
        ]  # fmt: skip

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the largest error against processor time with set-up, a line per solver and setting, from rest."""
        shown = [(row.case, row.values) for row in rows]
        figure = plot_curves(Panel.by_case(shown))
        return {"Error to the solver's own law; defaults as full lines, other settings dotted.": to_svg(figure)}

    def _list_entrants(self) -> list[Entrant]:
        """List solvers and settings: the first ones of other packages where not all is asked."""
        counts: dict[str, int] = {}
        chosen = []
        for entrant in list_entrants(self.files):
            counts[entrant.solver] = counts.get(entrant.solver, 0) + 1
            if self.whole or not entrant.file or counts[entrant.solver] <= QUICK_SETTINGS:
                chosen.append(entrant)
        return chosen
