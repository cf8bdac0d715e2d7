"""Error against processor time: solvers of other packages beside ours, on one set of problems."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....animation.plots import to_svg
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference.added import NotModelledError, added_solvers
from ....surrogate.methods import FENICSX_P2, FENICSX_P2P1
from ...harness.study import Column, Row, Study, Table, Task, Values, at_most
from . import problems
from .contest import (
    ACCURACIES,
    ANSWER,
    HUNDREDTH,
    OWN,
    OWN_SETTING,
    REST,
    check,
    describe_settings,
    find_budget,
    run_outside,
    run_own,
    summarise,
)
from .curves import Panel, plot_curves
from .laws import NEO_HOOKEAN
from .problems import LINEAR
from .solvers import NAMES
from .solvers.__main__ import load
from .solvers.protocol import SolverFile
from .summaries import FACES, JAWS, tabulate_best, tabulate_series, tabulate_times

CLOCK = 1e-4
"""[s] of a step of the clock at most: set-ups take some milliseconds."""


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

    whole: bool = option(False, "all problems with large heads, Poisson's ratios and stiffness contrasts: an hour")
    budget: float = 0.0
    files: tuple[str, ...] = option(
        (), "a solver's file of your own (docs/arena.md); repeat for several", name="--solver"
    )

    def tasks(self) -> Sequence[Task]:
        """List each problem by each solver, setting and start; InputError for options out of range."""
        if self.budget < 0:
            raise InputError(f"budget: expected at least 0 s, got {self.budget:g}")
        return [
            Task(case.name, f"{title}; {setting}; {start}")
            for case in problems.CASES.values()
            if self.whole or case.quick
            for title, settings in self._rivals().items()
            if title not in (FENICSX_P2, FENICSX_P2P1) or (self.whole and case.quadratic)
            for start in (REST, ANSWER)
            if start == REST or (case.start_at_answer and title not in OWN)
            for setting in settings[: None if self.whole else 2]
        ]

    def measure(self, task: Task) -> Values:
        """Run one solver on one problem."""
        title, setting, start = task.method.split("; ")
        problem = problems.make(task.case)
        files = self._files()
        law = files[title].LAW or NEO_HOOKEAN if title in files else OWN.get(title, (NEO_HOOKEAN,))[0]
        how: dict[str, Any] = OWN[title][1] if title in OWN else {"solver": title}
        element = how.get("element", LINEAR)
        try:
            linear = problems.answer(task.case, law)
            answers = {
                "own": linear if element == LINEAR else problems.answer(task.case, law, element),
                "neo": problems.answer(task.case, NEO_HOOKEAN),
            }
        except SoftdecaError as without:
            raise NotModelledError(f"no answer to compare with: {without}") from None
        begin = answers["own"] if start == ANSWER else problem.begin
        size = len(problem.tets) * (1 if element == LINEAR else 8)  # so many linear tets have its nodes
        budget = self.budget or (find_budget(size) if self.whole else 1.0)  # [s] of a solve
        if title in files:
            file = files[title]
            name = next(name for name, other in self._name_solvers().items() if other is file)
            settings = file.SETTINGS[setting]
            lines = run_outside(name, problem.arrays(begin), problem.warm.arrays(), answers, settings, budget)
            check(lines, title, file.PACKAGES)
            about = {"law": file.LAW or "its own, not given to FEniCSx", "dtype": file.DTYPE}
        else:
            settings = how
            lines = run_own(
                problem.scene(law), problem.warm.scene(law), problem.skin, answers, budget, start=begin, **how
            )
            about = {"law": law, "dtype": "float64"}
        values = summarise(lines) | {"settings": describe_settings(settings), "budget_s": budget}
        values = {"solver": title, "setting": setting, "start": start, **about, **values}
        values["law_mm"] = _largest(linear, answers["neo"], problem)
        if element != LINEAR:
            values["element_mm"] = _largest(answers["own"], linear, problem)
        closed = problem.closed(law)
        if closed is not None:
            values["closed_mm"] = _largest(answers["own"], closed, problem)
        return values

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that FEniCSx has the closed form, and that solvers have the bar within their own tolerance."""
        gates = []
        steps = [row.values["clock_s"] for row in rows if row.values["clock_s"] is not None]
        if steps:
            gates.append(at_most("step of the processors' clock, the coarsest [s]", max(steps), CLOCK))
        closed = [row.values["closed_mm"] for row in rows if "closed_mm" in row.values]
        if closed:
            gates.append(at_most("FEniCSx to the bar's closed form [mm]", max(closed), 1e-6))
        for title, file in self._files().items():
            ends = [
                row.values["floor_mm"]
                for row in rows
                if row.case == "bar" and row.values["solver"] == title and row.values["start"] == REST
                and row.values["max_mm"] is not None
            ]  # fmt: skip
            if ends and np.isfinite(file.TOLERANCE):
                gates.append(at_most(f"{title} on the bar, best setting [mm]", min(ends), file.TOLERANCE))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell who was first to 0.01 mm on each problem."""
        sentences = []
        for case in dict.fromkeys(row.case for row in rows):
            times = sorted(
                (row.values["set_up_s"] + row.values["to_hundredth_s"], row.values["solver"])
                for row in rows
                if row.case == case and row.values["start"] == REST and row.values["to_hundredth_s"] is not None
            )
            first = dict((title, seconds) for seconds, title in reversed(times))
            ranked = sorted(first.items(), key=lambda item: item[1])[:4]
            sentences.append(f"{case}: " + ", ".join(f"{title} {seconds:.2g} s" for title, seconds in ranked))
        return "First to 0.01 mm of their own law, set-up counted. " + "; ".join(sentences) + "."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate times to accuracies, who leaves the answer, and series of moduli."""
        biases = [
            (row.case, row.values["solver"], row.values["setting"], row.values["max_mm"], row.values["solve_s"])
            for row in rows
            if row.values["start"] == ANSWER and (row.values["max_mm"] or 0.0) > ACCURACIES[HUNDREDTH]
        ]
        return [
            tabulate_times(rows),
            Table("Started at the answer, these left it by more than 0.01 mm",
                  ["problem", "solver", "setting", "from the answer [mm]", "after [s]"], biases),
            tabulate_best(rows, "Heads whose jaw is opened", JAWS),
            tabulate_best(rows, "The face of an expression", FACES),
            tabulate_series(rows),
        ]  # fmt: skip

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the largest error against processor time with set-up, a line per solver and setting, from rest."""
        # Kept results have rows of problems that are no more.
        shown = [(row.case, row.values) for row in rows if row.case in problems.CASES]
        figure = plot_curves(Panel.by_case(shown))
        return {"Error to the solver's own law; defaults as full lines, other settings dotted.": to_svg(figure)}

    def _name_solvers(self) -> Mapping[str, SolverFile]:
        """Load the solvers' files, by what a run is asked for."""
        return {name: load_file(name) for name in (*NAMES, *self.files)}

    def _files(self) -> Mapping[str, SolverFile]:
        """Load the solvers' files, by title."""
        return {file.TITLE: file for file in self._name_solvers().values()}

    def _rivals(self) -> Mapping[str, Sequence[str]]:
        """Give settings by title: those of files, then ours and those that `add_solver` added."""
        outside = {title: list(file.SETTINGS) for title, file in self._files().items()}
        return outside | dict.fromkeys((*OWN, *added_solvers()), [OWN_SETTING])


_loaded: dict[str, SolverFile] = {}


def load_file(name: str) -> SolverFile:
    """Load a solver's file once per process; InputError for one that cannot be loaded or lacks a name."""
    if name not in _loaded:
        try:
            module: Any = load(name)
        except (Exception, SystemExit) as error:
            raise InputError(f"solver {name}: {type(error).__name__}: {error}") from error
        lacks = [key for key in (*SolverFile.__annotations__,) if not hasattr(module, key)]
        if lacks:
            raise InputError(f"solver {name}: it defines no {', '.join(lacks)}; see docs/arena.md")
        _loaded[name] = module
    return _loaded[name]


def _largest(a: Floats, b: Floats, problem: problems.Problem) -> float:
    """The largest distance [mm] of skin vertices."""
    return float(np.linalg.norm(a - b, axis=1)[problem.skin].max())
