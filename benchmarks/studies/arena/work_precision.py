"""The arena's list of one face: every solver on its energy and on ARAP's, over time and iterations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from ....animation.plots import to_svg
from ....lhm.base.errors import SoftdecaError
from ....lhm.base.mesh import Floats, Ints
from ....lhm.base.option import option
from ....reference import Parameters, Scene, apply_law, facial_scene, prepare
from ....reference.added import NotModelledError, added_laws, added_solvers
from ....surrogate import methods as m
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import ACCURACY, TIGHT, largest_distance
from ..person import OfPerson, Person
from .curves import Panel, plot_curves
from .entrants import Entrant, list_entrants
from .laws import PROJECTIVE, RIGID
from .problems import LINEAR, Problem, pull_handles
from .runs import ACCURACIES, HUNDREDTH, REST, TENTH, find_budget, run
from .solvers import libigl_arap
from .solvers.protocol import ArenaProblem
from .summaries import find_best, find_time, tabulate_times, tabulate_work

FACE, ARAP = "the face's energy (Eq. 15)", "ARAP's energy, same tets"
LAW_OF = {FACE: PROJECTIVE, ARAP: RIGID}
"""The laws of the arena by which solvers enter."""
ENDLESS = (m.PD_PLAIN, libigl_arap.TITLE)
"""These end by the arena's budget: local and global steps need thousands for the last digits."""
RIVALS = ((FACE, m.PD_PLAIN), (FACE, m.FENICSX), (ARAP, m.FENICSX), (ARAP, libigl_arap.TITLE))
"""Whom L-BFGS is to be ahead of, on which energy."""
OTHER = "cheekPuff*0.3"
"""The expression of the uncounted run."""


@dataclass(frozen=True, eq=False)
class Posed:
    """An expression of somebody's head by an energy, as solvers are given it; `small`: the same head, coarser."""

    text: str
    energy: str
    person: Person
    small: Person | None

    @cached_property
    def handles(self) -> Problem | None:
        """The problem of handles that ARAP's energy has."""
        return pull_handles(self.person.head, self.person.shape(self.text)) if self.energy == ARAP else None

    @cached_property
    def own_scene(self) -> Scene:
        """Its scene."""
        if self.handles is not None:
            return self.handles.scene(RIGID)
        scene = facial_scene(self.person.head, Parameters(), self.person.shape(self.text), cells="tets")
        law = next(
            (added.of_moduli for name, added in added_laws().items() if name_law_energy(name) == self.energy), None
        )
        return scene if law is None else apply_law(scene, law)

    @cached_property
    def answer(self) -> Floats:
        """The end of a tight run [mm]; SoftdecaError where it does not converge."""
        solver = "projective" if self.energy in LAW_OF else "fenicsx"
        solution = prepare(self.own_scene, solver=solver).solve(tolerance=TIGHT)
        if not solution.converged:
            raise SoftdecaError(f"the tight run: {solution.reason}")
        return solution.positions

    @property
    def skin(self) -> Ints:
        """All vertices: errors of each count."""
        return np.arange(len(self.own_scene.vertices))

    @property
    def warm(self) -> Posed:
        """Another expression of the coarser head."""
        assert self.small is not None
        return Posed(OTHER, self.energy, self.small, None)

    def scene(self, law: str) -> Scene:
        """Give its scene, whatever the name of its energy."""
        return self.own_scene

    def arrays(self, start: Floats | None = None) -> ArenaProblem:
        """Give the problem of handles as arrays; NotModelledError for the face's own energy."""
        if self.handles is None:
            raise NotModelledError("a face's own energy has terms that arrays do not say")
        return self.handles.arrays(start)


@dataclass(frozen=True)
class WorkPrecision(OfPerson):
    """Expressions of one head by solver and energy."""

    name = "work-precision"
    heading = "How long does each method take to be right?"
    question = "How near to the answer is each method after a given time, and after a given number of iterations?"
    cheap = "mouthPucker, ARAP's energy, same tets, FEniCSx"
    columns = (
        Column("settings", "settings"),
        Column("budget_s", "budget [s]"),
        Column("warm_up_s", "uncounted run before [s]", cost=True),
        Column("set_up_s", "prepare [s]", cost=True),
        Column("solve_s", "solve [s]", cost=True),
        Column("to_tenth_s", "to 0.1 mm [s]", cost=True),
        Column("to_hundredth_s", "to 0.01 mm [s]", cost=True),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("repeats", "repeats"),
        Column("max_mm", "largest error at the end [mm]"),
        Column("element_mm", "its answer to P1's, max [mm]"),
        Column("apart_mm", "its answer to PD's from rest, max [mm]"),
    )
    note = (
        "Processor time of one thread, of the run in the middle of five; slow solves have fewer, within half a minute. "
        "Each has run a coarser head's other expression before, which is not counted. The error is the largest "
        "distance of a vertex to a tight run. FEniCSx' linear tets share PD's tight run, which starts at their answer "
        "where they found another minimum. Quadratic tets have their own, and a law from a file has FEniCSx'. One "
        "iteration of PD is one solve with its factor; one of Newton is a linear system. libigl fits its rotations in "
        "float32, hence its own floor. Its handles are what the facial scene holds and every 16th vertex of the skin "
        "wrap. It and plain PD end after the arena's budget."
    )
    version = 3
    timed = True

    expressions: tuple[str, ...] = option(
        ("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker"), "as jawOpen*0.5+cheekPuff; repeat for several"
    )
    repeats: int = 5
    slow: bool = option(False, "also quadratic tets and scikit-fem: minutes each")

    def tasks(self) -> Sequence[Task]:
        """List each expression and energy by each method; InputError for one that cannot be read."""
        self.check(self.expressions)
        return [
            Task(name_case(text, energy), label)
            for text in self.expressions
            for energy in _list_energies()
            for label in self._list_entrants(energy)
        ]

    def measure(self, task: Task) -> Values:
        """Measure the curve of a solver."""
        cases = {
            name_case(text, energy): (text, energy) for text, energy in product(self.expressions, _list_energies())
        }
        text, energy = cases[task.case]
        posed, entrant = _pose(self, text, energy), self._list_entrants(energy)[task.method]
        answer, apart = _find_answer(posed, entrant)
        budget = find_budget(len(posed.own_scene.tets)) if entrant.solver in ENDLESS else np.inf
        values = run(entrant, posed, energy, {"own": answer}, budget, posed.own_scene.vertices, self.repeats)
        return {**values, **apart, "start": REST}

    def _list_entrants(self, energy: str) -> Mapping[str, Entrant]:
        """List the solvers of an energy, by their labels."""
        law, every, added = LAW_OF.get(energy, PROJECTIVE), list_entrants(), added_solvers()
        chosen = [each for each in every if each.law == law and each.solver not in added]
        if energy not in LAW_OF:
            chosen = [each for each in chosen if each.solver in (m.FENICSX, m.SKFEM)]
        quick = [each for each in chosen if self.slow or (each.element == LINEAR and each.solver != m.SKFEM)]
        return {each.solver: each for each in (*quick, *(each for each in every if each.solver in added))}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that L-BFGS is ahead of others on the same energy, and ends where Newton does."""
        gates = []
        for energy, rival in RIVALS:
            if not any((row.values["solver"], row.values["law"]) == (rival, energy) for row in rows):
                continue
            for prepared, what in ((False, "with preparation"), (True, "prepared")):
                name = f"time of {m.PD} over {rival}'s, worst accuracy below 0.1 mm, {what}; {energy}"
                gates.append(at_most(name, measure_lead(rows, rival, energy, prepared=prepared), 1.0, answer=False))
        newton = [
            row.values["max_mm"] for row in rows if row.values["solver"] == m.FENICSX and row.values["law"] in LAW_OF
        ]
        if newton:
            gates.append(at_most(f"{m.PD} to {m.FENICSX}, both tight [mm]", max(newton), ACCURACY))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how long each takes to 0.01 mm on the face's energy: medians over expressions."""
        times: dict[str, list[float]] = {}
        for row in rows:
            if row.values["law"] == FACE:
                seconds = find_time(row, HUNDREDTH, prepared=True)
                times.setdefault(row.values["solver"], []).append(np.inf if seconds is None else seconds)
        reached = [f"{label} {np.median(each):.2f} s" for label, each in times.items() if max(each) < np.inf]
        return f"To 0.01 mm from prepared scenes: {', '.join(reached)}." if reached else ""

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate times and iterations to accuracies."""
        return [tabulate_times(rows), tabulate_work(rows)] if rows else []

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the largest error against seconds with preparation and iterations, a line per solver and expression."""
        by_energy = Panel.by_case([(row.values["law"], row.values) for row in rows])
        panels = [each for panel in by_energy for each in (panel, replace(panel, over="work"))]
        if not panels:
            return {}
        figure = plot_curves(panels, floor=1e-7)  # [mm], below which the tight runs' own error shows
        return {"Error against time and iterations, a line per expression.": to_svg(figure)}


def measure_lead(rows: Sequence[Row], rival: str, energy: str, *, prepared: bool) -> float | None:
    """Measure PD's time over a rival's, worst over the problems and the accuracies at and below 0.1 mm.

    An accuracy that the rival never reaches is won if we reach it. None if we alone miss one, and without rows.
    """
    ratios = []
    for index in range(TENTH, len(ACCURACIES)):
        ours, theirs = (find_best(rows, solver, energy, index, prepared=prepared) for solver in (m.PD, rival))
        pairs = [(ours[case], theirs[case]) for case in ours.keys() & theirs.keys()]
        ratios += [mine / its for mine, its in pairs if min(mine, its) < np.inf]
    worst = max(ratios, default=np.inf)
    return None if worst == np.inf else worst


def name_case(text: str, energy: str) -> str:
    """Name an expression by an energy, as rows do."""
    return f"{text}, {energy}"


def name_law_energy(law: str) -> str:
    """Name the energy of a face of a law that a file has added, as rows do."""
    return f"the face of {law}"


def _list_energies() -> list[str]:
    return [FACE, ARAP, *map(name_law_energy, added_laws())]


@lru_cache(maxsize=2)
def _pose(study: WorkPrecision, text: str, energy: str) -> Posed:
    return Posed(text, energy, study.person(), study.person(level=1))


def _find_answer(posed: Posed, entrant: Entrant) -> tuple[Floats, dict[str, float]]:
    """The answer [mm] that a solver is to find, and how far it is from the problem's, by the column's key.

    A face that folds has several minima: projective dynamics answers for the one that linear finite elements found.
    """
    answer = posed.answer
    if entrant.solver in (m.PD, m.PD_PLAIN, m.PD_ANDERSON) or entrant.file or posed.energy not in LAW_OF:
        return answer, {}
    own = prepare(posed.own_scene, **entrant.options).solve(tolerance=TIGHT).positions
    if entrant.element != LINEAR:
        return own, {"element_mm": largest_distance(own, answer)}
    if largest_distance(own, answer) > ACCURACY:
        answer = prepare(posed.own_scene, solver="projective").solve(tolerance=TIGHT, start=own).positions
    return answer, {"apart_mm": largest_distance(answer, posed.answer)}
