"""Error against time and iterations: every solver on the face's energy and on ARAP's, and rigs of that face."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from ....animation.plots import to_svg
from ....lhm import expressions
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference import Parameters, Scene, apply_law, facial_scene, prepare
from ....reference.added import NotModelledError, added_laws, added_solvers
from ....surrogate import methods as m
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import ACCURACY, TIGHT, Stopwatch, distances, largest_distance, repeat_work
from ..person import OfPerson
from .contest import (
    ACCURACIES,
    HUNDREDTH,
    OWN,
    OWN_SETTING,
    REST,
    TENTH,
    Lines,
    check,
    find_budget,
    run_outside,
    run_own,
    summarise_repeats,
)
from .curves import Panel, plot_curves
from .laws import RIGID
from .problems import Problem, pull_handles
from .solvers import libigl_arap
from .summaries import find_best, find_time, tabulate_times, tabulate_work

FACE, ARAP = "the face's energy (Eq. 15)", "ARAP's energy, same tets"
BY_ENERGY: Mapping[str, Sequence[str]] = {
    FACE: (m.PD, m.PD_PLAIN, m.PD_ANDERSON, m.FENICSX, m.FENICSX_P2, m.SKFEM),
    ARAP: (m.PD, m.PD_PLAIN, m.PD_ANDERSON, m.FENICSX, libigl_arap.TITLE),
}
SLOW = (m.FENICSX_P2, m.SKFEM)
"""Left out unless they are asked for: a minute a solve."""
OTHER = "cheekPuff*0.3"
"""The expression of the uncounted run."""
ENDLESS = (m.PD_PLAIN, libigl_arap.TITLE)
"""These end by the arena's budget: local and global steps need thousands for the last digits."""
RIVALS = ((FACE, m.PD_PLAIN), (FACE, m.FENICSX), (ARAP, m.FENICSX), (ARAP, libigl_arap.TITLE))
"""Whom L-BFGS is to be ahead of, on which energy."""


@dataclass(frozen=True, eq=False)
class Posed:
    """An expression of a head by an energy: its scene, its answer [mm], and the problem of handles that ARAP's is.

    warm: another, small scene of the same terms, for the uncounted run before a solve.
    """

    text: str
    energy: str
    scene: Scene
    answer: Floats
    handles: Problem | None
    warm: Scene


@dataclass(frozen=True)
class WorkPrecision(OfPerson):
    """Expressions of one head by solver and energy."""

    name = "work-precision"
    heading = "How long does each method take to be right?"
    question = "How near to the answer is each method after a given time, and after a given number of iterations?"
    needs = ("people", "heads", "network")
    cheap = "mouthPucker, the face's energy (Eq. 15), network"
    columns = (
        Column("set_up_s", "prepare or bind [s]", cost=True),
        Column("solve_s", "solve or frame [s]", cost=True),
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
        "Processor time of one thread, of the run in the middle of at least five after one that is not counted, each "
        "after one of a smaller scene; slow solves have fewer, within half a minute. The error is the largest distance "
        "of a vertex to a tight run. FEniCSx' linear tets share PD's tight run, which starts at their answer where "
        "they found another minimum. Quadratic tets have their own, and a law from a file has FEniCSx'. One iteration "
        "of PD is one solve with its factor; one of Newton is a linear system. Rigs are judged on the skin, under "
        "default parameters, where bones "
        "carry nothing. A bind is given the head. libigl fits its rotations in float32, hence its own floor. Its "
        "handles are what the facial scene holds and every 16th vertex of the skin wrap. It and plain PD end after "
        "the arena's budget."
    )
    version = 2
    timed = True

    expressions: tuple[str, ...] = option(
        ("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker"), "as jawOpen*0.5+cheekPuff; repeat for several"
    )
    repeats: int = 5
    slow: bool = option(False, "also quadratic tets and scikit-fem: minutes each")

    def tasks(self) -> Sequence[Task]:
        """List each expression and energy by each method; InputError for one that cannot be read."""
        self.check(self.expressions)
        laws: dict[str, Sequence[str]] = {name_law_energy(law): (m.FENICSX, m.SKFEM) for law in added_laws()}
        return [
            Task(name_case(text, energy), label)
            for text in self.expressions
            for energy, solvers in {**BY_ENERGY, **laws}.items()
            for label in (*solvers, *added_solvers(), *(m.READY if energy == FACE else ()))
            if self.slow or label not in SLOW
        ]

    def measure(self, task: Task) -> Values:
        """Measure the curve of a solver, or the one point of a rig."""
        energies = (FACE, ARAP, *map(name_law_energy, added_laws()))
        cases = {name_case(text, energy): (text, energy) for text, energy in product(self.expressions, energies)}
        posed = _pose(self, *cases[task.case])
        about = {"solver": task.method, "setting": OWN_SETTING, "start": REST, "law": posed.energy}
        return about | (self._bind(posed, task.method) if task.method in m.READY else self._solve(posed, task.method))

    def _solve(self, posed: Posed, label: str) -> dict[str, Any]:
        budget = find_budget(len(posed.scene.tets)) if label in ENDLESS else np.inf
        if label == libigl_arap.TITLE:
            assert posed.handles is not None
            arrays, warm = posed.handles.arrays(), posed.handles.warm.arrays()
            (settings,) = libigl_arap.SETTINGS.values()

            def run() -> Lines:
                lines = run_outside("libigl_arap", arrays, warm, {"own": posed.answer}, settings, budget)
                check(lines, label, libigl_arap.PACKAGES)
                return lines

            return summarise_repeats(repeat_work(run, self.repeats))
        how: Mapping[str, Any] = OWN[label][1] if label in OWN else {"solver": label}
        answer, apart = _find_answer(posed, label, how)
        every = np.arange(len(posed.scene.vertices))

        def run_ours() -> Lines:
            return run_own(posed.scene, posed.warm, every, {"own": answer}, budget, **how)

        runs = repeat_work(run_ours, self.repeats)
        return summarise_repeats(runs) | apart

    def _bind(self, posed: Posed, label: str) -> dict[str, Any]:
        """Bind a rig and move it; NotModelledError for a face that it refuses, as a network those of strangers."""
        person = self.person()
        weights = expressions.parse_weights(posed.text)
        answer = person.head.skin_after(person.shape(posed.text), posed.answer[: len(person.head.bone)])
        method = m.METHODS[label]
        try:
            method.bind(person.face(Parameters()))  # not counted, like the first solve
        except InputError as refusal:
            raise NotModelledError(f"{label}: {refusal}") from None
        face, watch = person.face(Parameters()), Stopwatch()
        step = method.bind(face).frame
        bind = watch.lap()[1]
        skin, times = step(weights).astype(np.float64), []
        for _ in range(10 * self.repeats):
            watch.lap()
            step(weights)
            times.append(watch.lap()[1])
        error = largest_distance(skin, answer)
        return {
            "set_up_s": [0.0 if label == m.BLENDSHAPES else bind],
            "solve_s": times,
            "repeats": len(times),
            "seconds": [float(np.median(times))],
            "error_mm": [error],
            "max_mm": error,
            "mean_mm": float(distances(skin, answer).mean()),
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that L-BFGS is ahead of others on the same energy, and ends where Newton does."""
        gates = []
        for energy, rival in RIVALS:
            runs = _select(rows, energy)
            if not any(row.values["solver"] == rival for row in runs):
                continue
            for prepared, what in ((False, "with preparation"), (True, "prepared")):
                name = f"time of {m.PD} over {rival}'s, worst accuracy below 0.1 mm, {what}; {energy}"
                gates.append(at_most(name, measure_lead(runs, rival, prepared=prepared), 1.0, answer=False))
        newton = [
            row.values["max_mm"] for row in rows if row.values["solver"] == m.FENICSX and row.values["law"] in BY_ENERGY
        ]
        if newton:
            gates.append(at_most(f"{m.PD} to {m.FENICSX}, both tight [mm]", max(newton), ACCURACY))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how long each takes to 0.01 mm, and what rigs reach: medians over expressions."""
        solved: dict[str, list[float | None]] = {}
        rigs: dict[str, list[Values]] = {}
        for row in _select(rows, FACE):
            if row.values["solver"] in m.READY:
                rigs.setdefault(row.values["solver"], []).append(row.values)
            else:
                times = solved.setdefault(row.values["solver"], [])
                times.append(find_time(row, HUNDREDTH, prepared=True))
        sentences = []
        reached = {label: [time for time in times if time is not None] for label, times in solved.items()}
        phrases = [f"{label} {np.median(reached[label]):.2f} s" for label in solved if None not in solved[label]]
        if phrases:
            sentences.append(f"To 0.01 mm from prepared scenes: {', '.join(phrases)}.")
        frames = []
        for label, records in rigs.items():
            time, bind, mean = (
                np.median([values[key] for values in records]) for key in ("solve_s", "set_up_s", "mean_mm")
            )
            frames.append(f"{label} {1e3 * time:.3f} ms after {bind:.2f} s, and {mean:.3f} mm")
        if frames:
            sentences.append(f"A frame, the bind before the first, and its mean error: {', '.join(frames)}.")
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate times and iterations to accuracies."""
        solved = [row for row in rows if row.values["solver"] not in m.READY]
        return [tabulate_times(solved), tabulate_work(solved)] if solved else []

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the largest error against seconds with preparation and iterations, a line per solver and expression."""
        panels = []
        for energy in dict.fromkeys(row.values["law"] for row in rows):
            records = [row.values for row in _select(rows, energy)]
            panels.append(Panel(energy, records))
            if energy == FACE:
                panels.append(Panel(energy, [values for values in records if values["solver"] not in m.READY], "work"))
        if not panels:
            return {}
        figure = plot_curves(panels, floor=1e-7)  # [mm], below which the tight runs' own error shows
        return {"Error against time and iterations, a line per expression.": to_svg(figure)}


def measure_lead(rows: Sequence[Row], rival: str, *, prepared: bool) -> float | None:
    """Measure PD's time over a rival's, worst over the problems and the accuracies at and below 0.1 mm.

    An accuracy that the rival never reaches is won if we reach it. None if we alone miss one, and without rows.
    """
    ratios = []
    for index in range(TENTH, len(ACCURACIES)):
        ours, theirs = (find_best(rows, solver, index, prepared=prepared) for solver in (m.PD, rival))
        for case in ours.keys() & theirs.keys():
            seconds, its = ours[case], theirs[case]
            if seconds is not None:
                ratios.append(0.0 if its is None else seconds / its)
            elif its is not None:
                return None
    return max(ratios, default=None)


def name_case(text: str, energy: str) -> str:
    """Name an expression by an energy, as rows do."""
    return f"{text}, {energy}"


def name_law_energy(law: str) -> str:
    """Name the energy of a face of a law that a file has added, as rows do."""
    return f"the face of {law}"


def _select(rows: Sequence[Row], energy: str) -> list[Row]:
    return [row for row in rows if row.values["law"] == energy]


@lru_cache(maxsize=2)
def _pose(study: WorkPrecision, text: str, energy: str) -> Posed:
    person, small = study.person(), study.person(level=1)
    shape = person.shape(text)
    handles = pull_handles(person.head, shape) if energy == ARAP else None
    law = next((added.of_moduli for name, added in added_laws().items() if name_law_energy(name) == energy), None)
    if handles is None:
        warm = facial_scene(small.head, Parameters(), small.shape(OTHER), cells="tets")
        scene = facial_scene(person.head, Parameters(), shape, cells="tets")
    else:
        scene, warm = handles.scene(RIGID), handles.warm.scene(RIGID)
    if law is not None:
        scene, warm = apply_law(scene, law), apply_law(warm, law)
    solution = prepare(scene, solver="projective" if law is None else "fenicsx").solve(tolerance=TIGHT)
    if not solution.converged:
        raise SoftdecaError(f"the tight run: {solution.reason}")
    return Posed(text, energy, scene, solution.positions, handles, warm)


def _find_answer(posed: Posed, label: str, how: Mapping[str, Any]) -> tuple[Floats, dict[str, float]]:
    """The answer [mm] that a solver is to find, and how far it is from the problem's, by the column's key.

    A face that folds has several minima: projective dynamics answers for the one that linear finite elements found.
    """
    answer = posed.answer
    if label not in (m.FENICSX, m.FENICSX_P2, m.SKFEM) or posed.energy not in BY_ENERGY:
        return answer, {}
    own = prepare(posed.scene, **how).solve(tolerance=TIGHT).positions
    if label == m.FENICSX_P2:
        return own, {"element_mm": largest_distance(own, answer)}
    if largest_distance(own, answer) > ACCURACY:
        answer = prepare(posed.scene, solver="projective").solve(tolerance=TIGHT, start=own).positions
    return answer, {"apart_mm": largest_distance(answer, posed.answer)}
