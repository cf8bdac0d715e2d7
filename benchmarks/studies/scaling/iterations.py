"""How time and memory grow: with the tets of a head, with the frames of a sequence, with processes side by side."""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm import expressions
from ....lhm.base.errors import InputError
from ....lhm.base.limits import REPEATS
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.template import LEVELS
from ....reference import Parameters, Solution, apply_law, facial_scene, prepare, projective
from ....reference.face.sequence import Sequence as Simulation
from ....surrogate.methods import FENICSX, FENICSX_NEO_HOOKEAN, PD
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import (
    ACCURACY,
    COUNTS,
    ENDED,
    MEMORY,
    TIGHT,
    TIMES,
    Stopwatch,
    count_unfinished,
    count_work,
    fit_slope,
    measure_megabytes,
    merge_repeats,
    repeat_work,
    time_solve,
    trace_to_itself,
)
from ..person import OfPerson, check_known
from .floor import count_factor_bytes

RATE = 60.0
FEM_TOLERANCE = 1e-8
GROWING = ("prepare_s", "solve_s", "cpu_s", "iterations", "linear_iterations", "iteration_ms", "scene_mb", "factor_mb")


@dataclass(frozen=True)
class Scaling(OfPerson):
    """Levels of the template by solver, lengths of a sequence, and processes that simulate side by side."""

    name = "scaling"
    heading = "How does the cost grow with mesh, frames and processes?"
    question = "How do time and memory grow with tets, with frames and with processes?"
    columns = (
        Column("size", "size"),
        *TIMES,
        Column("iteration_ms", "iteration [ms]", cost=True),
        *COUNTS,
        MEMORY,
        Column("factor_mb", "factor of the PD matrix [MB]"),
        Column("rate", "solves per second, all processes together"),
        ENDED,
    )
    note = (
        "Size: tets of a level; frames of a sequence at 60 Hz, prepared once; or processes that each solve one frame "
        "again and again. PD of a level starts at rest and ends when no vertex is farther than 0.01 mm from a tight "
        "run. FEniCSx' Newton ends at a gradient norm of 1e-8 of its start. Times are medians of five repeats after "
        "one that is not counted; slow solves have fewer, within half a minute. Each case has its own process; memory "
        "is beside head and libraries."
    )
    timed = True
    alone = True

    expression: str = option("jawOpen*0.7+mouthSmileLeft+mouthSmileRight", "as jawOpen*0.5+cheekPuff")
    levels: tuple[str, ...] = option(tuple(map(str, LEVELS)), "of the template, by tets; repeat", name="--levels")
    frames: tuple[str, ...] = option(("6", "12", "24", "48"), "repeat", name="--frames")
    processes: tuple[str, ...] = option(("1", "2"), "side by side; repeat", name="--processes")
    repeats: int = option(5, "of each solve, after one that is not counted", bound=REPEATS)

    def tasks(self) -> Sequence[Task]:
        """List each level by each solver, each length of a sequence, and each count of processes."""
        self.check([self.expression])
        check_known("level", self.levels, tuple(map(str, LEVELS)))
        for what, values in (("frames", self.frames), ("processes", self.processes)):
            if not all(value.isdecimal() and int(value) > 0 for value in values):
                raise InputError(f"{what}: whole numbers above 0 were expected, got {', '.join(values)}")
        if self.repeats < 1:
            raise InputError(f"repeats: must be at least 1, got {self.repeats}")
        tasks = [
            Task(f"level {level}", solver) for solver in (PD, FENICSX, FENICSX_NEO_HOOKEAN) for level in self.levels
        ]
        tasks += [Task(f"{count} frames", PD) for count in self.frames]
        return tasks + [Task(f"{count} processes", PD) for count in self.processes]

    def measure(self, task: Task) -> Values:
        """Measure the costs of one size."""
        kind, _, last = task.case.partition(" ")
        if kind == "level":
            return self._measure_level(int(last), task.method)
        return self._measure_sequence(int(kind)) if last == "frames" else self._measure_processes(int(kind))

    def _measure_level(self, level: int, solver: str) -> Values:
        of = self.person(level)
        make = partial(facial_scene, of.head, Parameters(), of.shape(self.expression), bones="prescribed")
        found: dict = {"size": len(make().tets)}
        if solver == PD:
            held = measure_megabytes(make)
            prepared = projective.prepare(make())
            _, trace = trace_to_itself(prepared)
            tolerance = trace.tolerance_for(ACCURACY) or TIGHT
            runs = repeat_work(lambda: time_solve(make, tolerance), self.repeats)
            found |= {
                "factor_mb": count_factor_bytes(prepared) / 1e6,
                "iteration_ms": 1e3 * _time_iteration(trace.seconds),
            }
        else:
            scene = (lambda: apply_law(make(), "neo-Hookean")) if solver == FENICSX_NEO_HOOKEAN else make
            held = measure_megabytes(scene, solver="fenicsx")
            runs = repeat_work(lambda: time_solve(scene, FEM_TOLERANCE, solver="fenicsx"), self.repeats)
            found["iteration_ms"] = 1e3 * float(np.median([_time_iteration(run.history.time) for run, _ in runs]))
        return found | merge_repeats([row for _, row in runs]) | {"scene_mb": held}

    def _measure_sequence(self, frames: int) -> Values:
        of = self.person()
        skins = of.blend(expressions.conversation(np.random.default_rng(3), frames + 1, rate=RATE))

        def play() -> Values:
            watch = Stopwatch()
            running = Simulation(of.head, Parameters(), time_step=1.0 / RATE)
            running.frame(skins[0])
            first, _ = watch.lap()
            solutions = [running.frame(skin) for skin in skins[1:]]
            wall, cpu = watch.lap()
            ended = next((s for s in solutions if not s.converged), solutions[-1])
            iterations = sum(s.iterations for s in solutions)
            return {"prepare_s": first, "solve_s": wall, "cpu_s": cpu, **count_work(ended), "iterations": iterations}

        return {"size": frames} | merge_repeats(repeat_work(play, self.repeats))

    def _measure_processes(self, processes: int) -> Values:
        with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
            found = list(pool.map(_solve_again_and_again, [self] * processes))
        seconds = [float(np.median(times)) for times, _ in found]
        rows = {"solve_s": [t for times, _ in found for t in times], "rate": float(np.sum(1.0 / np.array(seconds)))}
        return {"size": processes, **rows, **found[0][1]}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all reach what was asked."""
        return [at_most("solves that did not converge", count_unfinished([row.values for row in rows]), 0)]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the exponents of the solve."""
        found = [
            f"{what} {solver} to the power {exponent:.2f}"
            for what, solver, exponents in _fit_exponents(rows)
            if (exponent := exponents["cpu_s"]) is not None
        ]
        rates = {row.values["size"]: row.values["rate"] for row in rows if row.values.get("rate")}
        gain = [f"{n} processes simulate {rate / rates[1]:.2f} times as fast as one" for n, rate in rates.items()
                if n > 1 and 1 in rates]  # fmt: skip
        return (f"Processor time grows: {'; '.join(found)}. " if found else "") + "".join(f"{each}." for each in gain)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate the exponents of all that grows."""
        titles = {column.key: column.title for column in self.columns}
        lines = [[what, solver, *(slopes[key] for key in GROWING)] for what, solver, slopes in _fit_exponents(rows)]
        return [Table("Fitted exponents", ["over", "method", *(titles[key] for key in GROWING)], lines)]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw seconds, iterations and memory over tets."""
        figure, axes = subplots(1, 3, figsize=(11, 3.6))
        for solver in (PD, FENICSX, FENICSX_NEO_HOOKEAN):
            of = [row for row in rows if row.case.startswith("level") and row.method == solver]
            sizes = [row.values["size"] for row in of]
            for axis, key in zip(axes, ("cpu_s", "iterations", "scene_mb"), strict=True):
                if of:
                    axis.plot(sizes, [float(np.median(row.values[key])) for row in of], "o-", label=solver)
        for axis, what in zip(axes, ("processor time [s]", "iterations", "scene and solver [MB]"), strict=True):
            axis.set(xscale="log", yscale="log", xlabel="tets", ylabel=what)
        axes[0].legend()
        return {"Cost of a cold frame against the tets of the template's levels.": to_svg(figure)}


def _time_iteration(times: Sequence[float] | Floats) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def _solve_again_and_again(study: Scaling) -> tuple[list[float], dict]:
    of = study.person()
    prepared = prepare(facial_scene(of.head, Parameters(), of.shape(study.expression)))

    def solve_once() -> tuple[float, Solution]:
        watch = Stopwatch()
        solution = prepared.solve()
        return watch.lap()[0], solution

    runs = repeat_work(solve_once, study.repeats)
    return [seconds for seconds, _ in runs], count_work(runs[-1][1])


def _fit_exponents(rows: Sequence[Row]) -> list[tuple[str, str, dict[str, float | None]]]:
    """Over what, the method, and the exponents of all that grows."""

    def summarise(value) -> float | None:
        return None if value is None else float(np.median(value))

    found = []
    for start, what in (("level", "with tets"), ("frames", "with frames")):
        for solver in dict.fromkeys(row.method for row in rows):
            of = [row.values for row in rows if start in row.case and row.method == solver]
            if len(of) > 1:
                sizes = [values["size"] for values in of]
                slopes = {key: fit_slope(sizes, [summarise(v.get(key)) for v in of]) for key in GROWING}
                found.append((what, solver, slopes))
    return found
