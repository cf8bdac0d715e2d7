"""Error against time and iterations: every solver on the face's energy and on ARAP's, and what learns from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm import expressions
from ....lhm.base.errors import InputError, MissingDependencyError, SoftdecaError
from ....lhm.base.limits import REPEATS
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference import Parameters, Scene, apply_law, facial_scene, prepare
from ....reference.added import added_laws, added_solvers
from ....surrogate.methods import (
    BLENDSHAPES,
    CARRIED,
    DERIVATIVES,
    FENICSX,
    FENICSX_P2,
    LIBIGL_ARAP,
    METHODS,
    NETWORK,
    NETWORK_AND_DERIVATIVES,
    PD,
    PD_ANDERSON,
    PD_PLAIN,
    SETTLED,
    SKFEM,
    get_method,
)
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import ACCURACY, TIGHT, Stopwatch, Trace, distances, largest_distance, repeat_work, trace_solve
from ..person import OfPerson, Person
from . import arap

ACCURACIES = tuple(float(f"{digit}e{power}") for power in range(0, -7, -1) for digit in (3, 1))[1:]
"""[mm], from 1 to 1e-6."""
BELOW = 0.1
"""[mm] at and below which our solver is to be ahead."""
LEAST_ERROR = 1e-7
"""[mm], below which the tight runs' own error shows."""
FACE, ARAP, LEARNED = "the face's energy (Eq. 15)", "ARAP's energy, same tets", "learned of the face's energy"
PROJECTIVE = {PD: "lbfgs", PD_PLAIN: "plain", PD_ANDERSON: "anderson"}
BY_ENERGY = {
    FACE: (*PROJECTIVE, FENICSX, FENICSX_P2, SKFEM),
    ARAP: (*PROJECTIVE, FENICSX, LIBIGL_ARAP),
    LEARNED: (NETWORK, NETWORK_AND_DERIVATIVES, DERIVATIVES, SETTLED, CARRIED, BLENDSHAPES),
}
SLOW = (FENICSX_P2, SKFEM)
"""Left out unless they are asked for: a minute a solve."""
RIVALS = ((FACE, PD_PLAIN), (FACE, FENICSX), (ARAP, FENICSX), (ARAP, LIBIGL_ARAP))
"""Whom L-BFGS is to be ahead of, on which energy."""
PLAIN_ENOUGH, PLAIN_LIMIT = 0.003, 1500
"""Plain projective dynamics is stopped here [mm], after so many iterations: it needs thousands for more."""
POINTS = 80
"""Of a curve that are kept at most, evenly in the logarithm of the iteration."""


@dataclass(frozen=True)
class WorkPrecision(OfPerson):
    """Expressions of one head by solver and energy."""

    name = "work-precision"
    heading = "How long does each method take to be right?"
    question = "How near to the answer is each method after a given time, and after a given number of iterations?"
    columns = (
        Column("prepare_s", "prepare or bind [s]", cost=True),
        Column("solve_s", "solve or frame [s]", cost=True),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("repeats", "repeats"),
        Column("error", "largest error at the end [mm]"),
        Column("to_pd_mm", "to PD's tight answer, max [mm]"),
        Column("apart_mm", "its answer to PD's from rest, max [mm]"),
    )
    note = (
        "Times of a solve are medians of at least five repeats after one that is not counted; slow solves have fewer, "
        "within half a minute. The error is the largest distance of a vertex to a tight run. FEniCSx' linear tets "
        "share PD's tight run, which starts at their answer where they found another minimum. Quadratic tets have "
        "their own, and a law from a file has FEniCSx'. One iteration of PD is one solve with its factor; one of "
        "Newton is a linear system. Learned methods are judged on the skin, under default parameters, where bones "
        "carry nothing. Beside them stand the simulator's first order, the settled neutral face, carried bones and "
        "blendshapes. A bind is given the head. libigl (one thread) fits its rotations in float32, hence its own "
        "floor. Its handles are what the facial scene holds and every 16th vertex of the skin wrap. Plain PD stops "
        "near 0.003 mm. Quadratic tets with a pressure solve another, incompressible law: see the study `mixed`."
    )
    timed = True

    expressions: tuple[str, ...] = option(
        ("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker"), "as jawOpen*0.5+cheekPuff; repeat for several"
    )
    repeats: int = option(5, "of each solve, after one that is not counted", bound=REPEATS)
    slow: bool = option(False, "also quadratic tets and scikit-fem: minutes each")

    def tasks(self) -> Sequence[Task]:
        """List each expression by each method; InputError for none, and for no repeat."""
        self.check(self.expressions)
        if not self.expressions or self.repeats < 1:
            raise InputError(f"expressions: {len(self.expressions)}, repeats: {self.repeats}; expected 1 or more")
        laws: dict[str, Sequence[str]] = {name_law_energy(law): (FENICSX, SKFEM) for law in added_laws()}
        return [
            Task(text, f"{label}; {energy}")
            for text in self.expressions
            for energy, labels in (BY_ENERGY | laws).items()
            for label in (labels if energy == LEARNED else (*labels, *added_solvers()))
            if self.slow or label not in SLOW
        ]

    def measure(self, task: Task) -> Values:
        """Measure the curve of a solver, or the one point of what has learned."""
        label, energy = task.method.split("; ")
        if energy == LEARNED:
            values = self._run_learned(task.case, label)
        else:
            values = self._solve(_pose(self, task.case, energy), label)
        return {"energy": energy, "label": label} | values

    def _solve(self, problem: _Problem, label: str) -> dict:
        if label == LIBIGL_ARAP:
            if not arap.is_installed():
                raise MissingDependencyError("libigl is not installed (softdeca[bench])")
            assert problem.handles is not None
            runs = []
            for _ in range(self.repeats):
                answer, seconds, trace, _ = arap.solve_by_igl(problem.scene, problem.handles, problem.truth)
                runs.append(_Run(seconds, trace, answer, None))
            return _summarise_runs(runs, problem.truth)
        if label in PROJECTIVE:
            how: dict = {"method": PROJECTIVE[label]}
            limits: dict = {"enough": PLAIN_ENOUGH, "max_iterations": PLAIN_LIMIT} if label == PD_PLAIN else {}
        else:
            solver = label if label in added_solvers() else "skfem" if label == SKFEM else "fenicsx"
            how, limits = {"solver": solver}, {}
            how |= {"element": "P2"} if label == FENICSX_P2 else {}
        truth = problem.truth
        if label == FENICSX_P2:
            truth = prepare(problem.scene, **how).solve(tolerance=TIGHT).positions
        elif label in (FENICSX, SKFEM) and problem.is_projective:
            own = prepare(problem.scene, **how).solve(tolerance=TIGHT).positions
            if largest_distance(own, truth) > ACCURACY:
                # A face that folds has several minima: projective dynamics answers for the one that this solver found.
                truth = prepare(problem.scene, solver="projective").solve(tolerance=TIGHT, start=own).positions

        def run() -> _Run:
            watch = Stopwatch()
            prepared = prepare(problem.scene, **how)
            seconds = watch.lap()[0]
            solution, trace = trace_solve(prepared, truth, **limits)
            return _Run(seconds, trace, solution.positions, solution.detail.get("linear_iterations"))

        # The first, not counted: forms are compiled once per kind of scene and machine, kernels once per process.
        compared = problem.truth if label == FENICSX_P2 else truth
        apart = largest_distance(truth, problem.truth)
        return _summarise_runs(repeat_work(run, self.repeats), compared) | {"apart_mm": apart}

    def _run_learned(self, text: str, label: str) -> dict:
        of, problem = self.person(), _pose(self, text, FACE)
        weights, shape = expressions.parse_weights(text), of.shape(text)
        truth = of.head.skin_after(shape, problem.truth[: len(of.head.bone)])
        method = METHODS[label]
        method.bind(of.face(Parameters()))  # not counted, like the first solve
        face, watch = of.face(Parameters()), Stopwatch()
        step = method.bind(face).frame
        seconds = watch.lap()[0]
        skin, times = step(weights).astype(np.float64), []
        for _ in range(10 * self.repeats):
            watch.lap()
            step(weights)
            times.append(watch.lap()[0])
        error = largest_distance(skin, truth)
        mean = float(distances(skin, truth).mean())
        return {
            "prepare_s": [0.0 if label == BLENDSHAPES else seconds],
            "solve_s": times,
            "repeats": len(times),
            "seconds": [float(np.median(times))],
            "error_mm": [error],
            "error": error,
            "to_pd_mm": error,
            "mean_mm": mean,
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that L-BFGS is ahead of others on the same energy, and ends where Newton does."""
        middles, gates = find_medians(rows), []
        for energy, rival in RIVALS:
            if (energy, rival) not in middles:
                continue
            for prepared, what in ((False, "with preparation"), (True, "prepared")):
                worst, _ = measure_lead(middles, energy, rival, prepared=prepared)
                name = f"time of {PD} over {rival}'s, worst accuracy below 0.1 mm, {what}; {energy}"
                # An infinite ratio is no JSON: what was not reached is None.
                gates.append(at_most(name, None if worst is None or np.isinf(worst) else worst, 1.0, answer=False))
        newton = [
            row.values["to_pd_mm"]
            for row in rows
            if row.values["label"] == FENICSX and row.values["energy"] in BY_ENERGY
        ]
        if newton:
            gates.append(at_most(f"{PD} to {FENICSX}, both tight [mm]", max(newton), ACCURACY))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how long each takes to 0.01 mm, and what the learned ones reach."""
        at = ACCURACIES.index(ACCURACY)
        sentences = [
            f"{label} {times[at]:.2f} s"
            for (energy, label), (times, *_) in find_medians(rows).items()
            if energy == FACE and times[at] is not None
        ]
        learned = {
            label: tuple(np.median([v[name] for v in of]) for name in ("solve_s", "prepare_s", "mean_mm"))
            for label in BY_ENERGY[LEARNED]
            if (of := [row.values for row in rows if row.values["label"] == label])
        }
        beside = [
            f"{label} {1e3 * time:.3f} ms after {bind:.2f} s, and {mean:.3f} mm"
            for label, (time, bind, mean) in learned.items()
        ]
        return (f"To 0.01 mm from prepared scenes: {', '.join(sentences)}. " if sentences else "") + (
            f"A frame, the bind before the first, and its mean error: {', '.join(beside)}." if beside else ""
        )

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate medians of times and iterations to accuracies, and who is ahead."""
        middles = find_medians(rows)
        head = ["energy", "method", "prepare [s]", *(f"to {accuracy:g} mm" for accuracy in ACCURACIES[::2])]
        times = [(energy, label, ready, *reached[::2]) for (energy, label), (reached, _, ready) in middles.items()]
        steps = [(energy, label, None, *reached[::2]) for (energy, label), (_, reached, _) in middles.items()]
        ahead = [
            (energy, label, "prepared" if prepared else "with preparation", worst, ", ".join(f"{b:g}" for b in behind))
            for energy, label in middles
            if label != PD
            for prepared in (True, False)
            for worst, behind in [measure_lead(middles, energy, label, prepared=prepared)]
        ]
        return [
            Table("Seconds of the solve to an accuracy, medians over expressions", head, times),
            Table("Iterations to an accuracy, medians over expressions", head, steps),
            Table(f"{PD} beside others",
                  ["energy", "rival", "counted", "our time over its, worst below 0.1 mm", "behind at [mm]"], ahead),
        ]  # fmt: skip

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the largest error against seconds with preparation and iterations, a line per solver and expression.

        Of a method that has learned, a hollow mark has the bind in it, as lines have preparation; a filled mark is one
        more frame.
        """
        found = {row.values["energy"] for row in rows}
        panels = [
            panel
            for panel in (
                (FACE, "seconds"),
                (FACE, "steps"),
                (ARAP, "seconds"),
                *((name_law_energy(law), "seconds") for law in added_laws()),
            )
            if panel[0] in found
        ]
        if not panels:
            return {}
        figure, grid = subplots(1, len(panels), figsize=(13 / 3 * len(panels), 4.6), sharey=True, squeeze=False)
        axes = grid.ravel()
        for axis, (energy, key) in zip(axes, panels, strict=True):
            named: set[str] = set()
            for row in rows:
                values, colour = row.values, get_method(row.values["label"]).colour
                label = None if values["label"] in named else values["label"]
                if values["energy"] == energy:
                    before = float(np.median(values["prepare_s"])) if key == "seconds" else 0.0
                    points = [
                        (before + x, error)
                        for x, error in zip(values[key], values["error_mm"], strict=True)
                        if error > LEAST_ERROR
                    ]
                    axis.plot(*zip(*points, strict=True), color=colour, lw=1.2, label=label)
                elif values["energy"] == LEARNED and energy == FACE and key == "seconds":
                    (frame,), (error,) = values["seconds"], values["error_mm"]
                    first = frame + float(np.median(values["prepare_s"]))
                    axis.plot([frame, first], [error, error], color=colour, lw=0.5, ls=":")
                    axis.plot(frame, error, "o", color=colour, label=label)
                    axis.plot(first, error, "o", color=colour, mfc="none")
                else:
                    continue
                named.add(values["label"])
            what = "preparation and solve [s]" if key == "seconds" else "iterations"
            axis.axhline(BELOW, color="#bbbbbb", lw=0.8, ls=":")
            axis.set(xscale="log", yscale="log", title=energy, xlabel=what, ylim=(LEAST_ERROR, None))
        axes[0].set_ylabel("largest error of a vertex [mm]")
        for axis, (_, key) in zip(axes, panels, strict=True):
            if key == "seconds":
                axis.legend()
        return {"Error against time and iterations, a line per expression.": to_svg(figure)}


def name_law_energy(law: str) -> str:
    """Name the energy of a face of a law that a file has added, as rows do."""
    return f"the face of {law}"


@dataclass(frozen=True, eq=False)
class _Problem:
    """A scene, its answer [mm], the handles of ARAP's, and whether the answer is projective dynamics'."""

    scene: Scene
    truth: Floats
    handles: arap.Handles | None
    is_projective: bool


@dataclass(frozen=True, eq=False)
class _Run:
    """A solve: preparation [s], its trace, where it ended [mm], and linear iterations where they are counted."""

    prepare_s: float
    trace: Trace
    positions: Floats
    linear_iterations: float | None


@lru_cache(maxsize=2)
def _pose(study: WorkPrecision, text: str, energy: str) -> _Problem:
    of: Person = study.person()
    shape = of.shape(text)
    face = facial_scene(of.head, Parameters(), shape)
    handles = arap.Handles.of(of.head, face, shape) if energy == ARAP else None
    scene = face if handles is None else handles.scene(face)
    of_law = next((added.of_moduli for name, added in added_laws().items() if name_law_energy(name) == energy), None)
    if of_law is not None:
        scene = apply_law(face, of_law)
    solution = prepare(scene, solver="projective" if of_law is None else "fenicsx").solve(tolerance=TIGHT)
    if not solution.converged:
        raise SoftdecaError(f"the tight run: {solution.reason}")
    return _Problem(scene, solution.positions, handles, of_law is None)


def _summarise_runs(runs: Sequence[_Run], truth: Floats) -> dict:
    """Runs of one solver on one scene, whose iterations are the same but for rounding: medians of their times."""
    length = min(len(run.trace.error) for run in runs)
    seconds = np.median([run.trace.seconds[:length] for run in runs], axis=0)
    trace = Trace(seconds.tolist(), runs[0].trace.error[:length], runs[0].trace.gradient[:length])
    kept = np.unique(np.geomspace(1, length, POINTS).round().astype(int)) - 1
    return {
        "prepare_s": [run.prepare_s for run in runs],
        "solve_s": [run.trace.seconds[-1] for run in runs],
        "repeats": len(runs),
        "iterations": length - 1,
        "linear_iterations": runs[0].linear_iterations,
        "steps": kept.tolist(),
        "seconds": seconds[kept].tolist(),
        "error_mm": [trace.error[k] for k in kept],
        "error": trace.error[-1],
        "seconds_to": [trace.seconds_to(accuracy) for accuracy in ACCURACIES],
        "steps_to": [trace.iterations_to(accuracy) for accuracy in ACCURACIES],
        "to_pd_mm": largest_distance(runs[0].positions, truth),
    }


Medians = Mapping[tuple[str, str], tuple[list, list, float]]


def find_medians(rows: Sequence[Row]) -> Medians:
    """Find medians over expressions, by energy and solver: seconds and iterations to each accuracy, and preparation.

    None where an expression has not come so far.
    """
    groups: dict[tuple[str, str], list[Values]] = {}
    for row in rows:
        if row.values["energy"] != LEARNED:
            groups.setdefault((row.values["energy"], row.values["label"]), []).append(row.values)
    return {
        key: (
            [_find_median([values["seconds_to"][k] for values in of]) for k in range(len(ACCURACIES))],
            [_find_median([values["steps_to"][k] for values in of]) for k in range(len(ACCURACIES))],
            float(np.median([np.median(values["prepare_s"]) for values in of])),
        )
        for key, of in groups.items()
    }


def _find_median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if len(known) == len(values) else None


def measure_lead(
    middles: Medians, energy: str, rival: str, *, prepared: bool = False
) -> tuple[float | None, list[float]]:
    """Our time over a rival's, worst over the accuracies at and below 0.1 mm, and those [mm] at which we are behind.

    An accuracy that the rival never reaches is won if we do reach it; one that we alone miss is an infinite ratio;
    one that neither reaches is left out. None if there is no rival.
    """
    if (energy, rival) not in middles or (energy, PD) not in middles:
        return None, []
    (mine, _, my_start), (other, _, other_start) = middles[energy, PD], middles[energy, rival]
    more, other_more = (0.0, 0.0) if prepared else (my_start, other_start)
    ratios: dict[float, float] = {}
    for accuracy, a, b in zip(ACCURACIES, mine, other, strict=True):
        if accuracy > BELOW or (a is None and b is None):
            continue
        ratios[accuracy] = np.inf if a is None else 0.0 if b is None else (a + more) / max(b + other_more, 1e-9)
    return max(ratios.values(), default=None), [accuracy for accuracy, ratio in ratios.items() if ratio > 1.0]
