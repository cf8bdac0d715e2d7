"""Frames per hour of the simulator: cold frames, a sequence, and a worker's memory."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ....lhm import expressions
from ....lhm.base.mesh import Floats
from ....reference import Face, Parameters, prepare
from ....reference.face.sequence import TOLERANCE
from ....reference.face.sequence import Sequence as Simulation
from ....surrogate.corpus.plan import CorpusPlan
from ....surrogate.methods import PD
from ...harness.processes import held_megabytes, peak_megabytes
from ...harness.study import Column, Row, Task, Values, at_least, at_most
from ..measures import ACCURACY, TIMES, count_unfinished, largest_distance, solve_with_tolerance, time_solve
from ..person import OfPerson

REFERENCE = 1e-9
"""Tolerance of tight runs, far below what 0.01 mm needs."""
MARGIN = 0.5
"""Share of the tolerance that the hardest frame of a kind needs; all frames of that kind are run with it."""
RATE = 60.0
"""[Hz] of the sequence."""
WARM = 0.5 * TOLERANCE
"""Tolerance of the sequence: that of `Sequence` leaves up to 0.02 mm."""
CHECKED_EVERY = 12
"""Frames of the sequence between two that are compared with a tight run."""
DEFAULT, DRAWN = "default p", "p as presets draw it"
PLAN = CorpusPlan()
"""Its mixture of p is that of every preset which names none of its own."""
COLD, SEQUENCE, WORKER = "cold frames", "a sequence", "a worker that fits a head and simulates"


@dataclass(frozen=True)
class Throughput(OfPerson):
    """Cold frames of several heads and materials; talk on one head; memory."""

    name = "throughput"
    question = "How many frames does one core simulate in an hour?"
    needs = ("people", "heads", "generator")
    columns = (
        Column("what", "what"),
        *TIMES,
        Column("iterations", "iterations", cost=True),
        Column("error_mm", "largest error [mm]"),
        Column("per_hour", "frames per core-hour"),
        Column("tolerance", "tolerance"),
        Column("value", "value"),
    )
    note = (
        "A cold frame has its own head, parameters and a lively frame of made-up talk; the fit is not counted. It is "
        "the neutral face where p moves it, scene, preparation and solve from rest. The tolerance is half of what the "
        "hardest frame of its kind needs for 0.01 mm to a tight run. The sequence is made-up talk at 60 Hz, prepared "
        "once; each frame starts from the last. Its tolerance is relative to the force of skin 1 mm off its target, "
        "and its tight runs start from its answers, since closed lids fold and have several minima. Seconds are "
        "processor time."
    )
    version = 3
    timed = True
    alone = True

    people: int = 3
    frames: int = 49

    def tasks(self) -> Sequence[Task]:
        """List each kind of cold frames, the sequence, the memory."""
        self.check()
        return [Task(COLD, DEFAULT), Task(COLD, DRAWN), Task(SEQUENCE, PD), Task(WORKER, PD)]

    def measure(self, task: Task) -> Values:
        """Measure a kind of frames, or the memory."""
        if task.case == COLD:
            return {"rows": self._measure_cold(task.method)}
        return {"rows": [self._measure_sequence()] if task.case == SEQUENCE else self._measure_memory()}

    def _make_frame(self, seed: int, kind: str) -> tuple[Face, Floats]:
        """A face of a seed's head with parameters of a kind, and the weights of a lively frame of talk."""
        person = self.person(seed=seed)
        talk = expressions.conversation(np.random.default_rng([seed, 2]), 120)
        p = PLAN.parameter_set(seed).parameters(person.head, person.space.mean) if kind == DRAWN else Parameters()
        return replace(person.face(p), choices={"cells": PLAN.cells}), talk[np.argmax(talk.sum(axis=1))]

    def _measure_cold(self, kind: str) -> list[dict]:
        seeds = range(self.seed, self.seed + self.people)
        frames = [self._make_frame(seed, kind) for seed in seeds]
        tight = [solve_with_tolerance(prepare(face.scene(weights)), REFERENCE) for face, weights in frames]
        tolerance = float(f"{MARGIN * min(needed for _, needed in tight):.0e}")
        rows = []
        for seed, frame, (truth, _) in zip(seeds, frames, tight, strict=True):
            # A copy of the face has not settled yet.
            face, weights = replace(frame[0]), frame[1]
            solution, row = time_solve(partial(face.scene, weights), tolerance)
            error = largest_distance(solution.positions, truth.positions)
            more = {"error_mm": error, "per_hour": 3600.0 / row["cpu_s"], "tolerance": tolerance}
            rows.append({"what": f"identity {seed}", **row, **more})
        return rows

    def _measure_sequence(self) -> dict:
        """Errors are to the minimum that a frame is near: closed lids fold, and have more than one."""
        person = self.person()
        face = Face(person.head)
        skins = person.blend(expressions.conversation(np.random.default_rng(3), self.frames, rate=RATE))
        prepared = prepare(face.expression_scene(skins[0]))
        running = Simulation(face, time_step=1.0 / RATE, tolerance=WARM)
        running.frame(skins[0])
        cpus, iterations, errors = [], [], []
        for t, skin in enumerate(skins[1:], 1):
            begin = time.process_time()
            solution = running.frame(skin)
            cpus.append(time.process_time() - begin)
            iterations.append(solution.iterations)
            if t % CHECKED_EVERY == 0:
                scene = face.expression_scene(skin)
                truth = prepared.solve(scene, start=solution.positions, tolerance=REFERENCE)
                errors.append(largest_distance(solution.positions, truth.positions))
        return {
            "what": "a frame",
            "cpu_s": cpus,
            "iterations": float(np.mean(iterations)),
            "error_mm": max(errors),
            "per_hour": 3600.0 / float(np.mean(cpus)),
            "tolerance": WARM,
        }

    def _measure_memory(self) -> list[dict]:
        """Measure the memory of this process: with its libraries, of the fit, and the peak."""
        loaded = held_megabytes()
        face, weights = self._make_frame(self.seed, DEFAULT)
        fitted = peak_megabytes()
        prepare(face.scene(weights)).solve(max_iterations=30)
        figures = {"libraries [MB]": loaded, "peak of the fit [MB]": fitted, "peak [MB]": peak_megabytes()}
        return [{"what": what, "value": value} for what, value in figures.items()]

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that frames are right to 0.01 mm, and fast and small enough."""
        gates: list[dict] = []
        for row in rows:
            lines = row.values["rows"]
            if row.case == COLD:
                slowest = max(line["cpu_s"] for line in lines)
                gates += [
                    at_most(f"cold frame, {row.method}: slowest [CPU s]", slowest, 1.0, answer=False),
                    at_least(f"cold frames per core-hour, {row.method}", _count_per_hour(row), 4000, answer=False),
                    at_most(
                        f"cold frame, {row.method}: largest error [mm]",
                        max(line["error_mm"] for line in lines),
                        ACCURACY,
                    ),
                    at_most(f"cold frames, {row.method}: not converged", count_unfinished(lines), 0),
                ]
            elif row.case == SEQUENCE:
                (line,) = lines
                median = float(np.median(line["cpu_s"]))
                gates += [
                    at_most("warm frame of a sequence, median [CPU s]", median, 0.2, answer=False),
                    at_least("warm frames per core-hour", line["per_hour"], 15000, answer=False),
                    at_most("warm frame: largest error [mm]", line["error_mm"], ACCURACY),
                ]
            else:
                gates.append(at_most("memory of a worker, fit and frame [MB]", lines[-1]["value"], 600.0))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell frames per hour."""
        counts = [f"{_count_per_hour(row):,.0f} cold frames of {row.method}" for row in rows if row.case == COLD]
        counts += [f"{_count_per_hour(row):,.0f} frames of a sequence" for row in rows if row.case == SEQUENCE]
        return f"A core simulates, per hour, {', '.join(counts)}." if counts else ""


def _count_per_hour(row: Row) -> float:
    """Frames of a row per hour of a processor."""
    return 3600.0 / float(np.mean([line["cpu_s"] for line in row.values["rows"]]))
