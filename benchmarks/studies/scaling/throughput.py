"""Frames per hour of the simulator: cold frames, a sequence, and a worker's memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ....lhm import expressions
from ....lhm.base.mesh import Floats
from ....reference import Face, Parameters, Prepared, facial_scene, prepare
from ....reference.face.sequence import TOLERANCE
from ....reference.face.sequence import Sequence as Simulation
from ....surrogate.methods import PD
from ...harness.processes import held_megabytes, peak_megabytes
from ...harness.study import Column, Row, Task, Values, at_least, at_most
from ..measures import ACCURACY, TIMES, Stopwatch, count_unfinished, largest_distance, time_solve, trace_to_itself
from ..person import OfPerson

REFERENCE = 1e-9
"""Tolerance of tight runs, far below what 0.01 mm needs."""
MARGIN = 0.5
"""Of the tolerance that the hardest frame of a kind needs, what all of that kind are run with."""
RATE = 60.0
"""[Hz] of the sequence."""
CHECKED_EVERY = 12
"""Frames of the sequence between two that are compared with a tight run."""
KINDS = {
    "default p": (),
    "the corpus' p at random": ("soft_stiffness", "target_stiffness", "gravity"),
    "every p at random": tuple(info.name for info in Parameters.infos()),
}
"""Which parameters are drawn, each over its whole range; the others are default."""
COLD, SEQUENCE, WORKER = "cold frames", "a sequence", "a worker that fits a head and simulates"


@dataclass(frozen=True)
class Throughput(OfPerson):
    """Cold frames of several heads and materials; talk on one head; memory."""

    name = "throughput"
    heading = "How many frames does one core simulate in an hour?"
    question = "How many frames an hour does a core simulate to 0.01 mm, and in how much memory?"
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
        "scene, preparation (assembly and factorisation) and solve from rest. The tolerance is a gradient norm "
        "relative to its start: half of what the hardest frame of its kind needs for 0.01 mm. Tight runs find it, and "
        "the error is the largest distance of a vertex to them. The sequence is made-up talk at 60 Hz, prepared once; "
        "each frame starts from the last, its scene is made anew. Its tolerance is relative to the force of skin 1 mm "
        "off its target. Seconds are those of a frame. The tight run of a frame starts from its answer, since closed "
        "lids fold and have several minima."
    )
    timed = True
    alone = True

    people: int = 3
    frames: int = 49

    def tasks(self) -> Sequence[Task]:
        """List each kind of cold frames, the sequence, the memory."""
        self.check()
        cold = [Task(COLD, kind) for kind in KINDS]
        return [*cold, Task(SEQUENCE, PD), Task(WORKER, PD)]

    def measure(self, task: Task) -> Values:
        """Measure a kind of frames, or the memory."""
        if task.case == COLD:
            return self._measure_cold(task.method)
        return self._measure_sequence() if task.case == SEQUENCE else self._measure_memory()

    def _make_frame(self, seed: int, kind: str) -> partial:
        """The scene of a lively frame of talk of a seed's head, with parameters of a kind."""
        person = self.person(seed=seed)
        weights = expressions.conversation(np.random.default_rng([seed, 2]), 120)
        shape = person.blend(weights[np.argmax(weights.sum(axis=1))][None])[0]
        rng = np.random.default_rng([seed, 1])
        drawn = Parameters(**{name: Parameters.info(name).sample(rng) for name in KINDS[kind]})
        return partial(facial_scene, person.head, drawn, shape)

    def _measure_cold(self, kind: str) -> Values:
        seeds = range(self.seed, self.seed + self.people)
        frames = [self._make_frame(seed, kind) for seed in seeds]
        tight = [trace_to_itself(prepare(frame()), tolerance=REFERENCE) for frame in frames]
        needed = [trace.tolerance_for(ACCURACY) or REFERENCE for _, trace in tight]
        tolerance = MARGIN * min(needed)
        power = math.floor(math.log10(tolerance))
        tolerance = float(f"{math.floor(tolerance / 10.0**power)}e{power}")  # one digit, rounded down
        rows = []
        for seed, frame, (truth, _) in zip(seeds, frames, tight, strict=True):
            solution, row = time_solve(frame, tolerance)
            seconds = row["scene_s"] + row["prepare_s"] + row["solve_s"]
            error = largest_distance(solution.positions, truth.positions)
            more = {"error_mm": error, "seconds": seconds, "per_hour": 3600.0 / seconds, "tolerance": tolerance}
            rows.append({"what": f"identity {seed}", **row, **more})
        return {"rows": rows}

    def _measure_sequence(self) -> Values:
        """The tolerance is that of `Sequence`, halved until the checked frames are within 0.01 mm."""
        person = self.person()
        skins = person.blend(expressions.conversation(np.random.default_rng(3), self.frames, rate=RATE))
        prepared = prepare(facial_scene(person.head, Parameters(), skins[0]))
        for halvings in range(5):
            line = self._play(skins, prepared, TOLERANCE / 2**halvings)
            if line["error_mm"] <= ACCURACY:
                break
        return {"rows": [line]}

    def _play(self, skins: Floats, prepared: Prepared, tolerance: float) -> dict:
        """Errors are to the minimum that a frame is near: closed lids fold, and have more than one."""
        head = self.person().head
        running = Simulation(Face(head), time_step=1.0 / RATE, tolerance=tolerance)
        running.frame(skins[0])
        walls, cpus, iterations, errors = [], [], [], []
        for t, skin in enumerate(skins[1:], 1):
            watch = Stopwatch()
            solution = running.frame(skin)
            wall, cpu = watch.lap()
            walls.append(wall)
            cpus.append(cpu)
            iterations.append(solution.iterations)
            if t % CHECKED_EVERY == 0:
                scene = facial_scene(head, Parameters(), skin)
                truth = prepared.solve(scene, start=solution.positions, tolerance=REFERENCE)
                errors.append(largest_distance(solution.positions, truth.positions))
        return {
            "what": "a frame",
            "solve_s": walls,
            "cpu_s": cpus,
            "iterations": float(np.mean(iterations)),
            "error_mm": max(errors),
            "per_hour": 3600.0 / float(np.mean(walls)),
            "tolerance": tolerance,
        }

    def _measure_memory(self) -> Values:
        """Measure the memory of this process: with its libraries, of the fit, and the peak."""
        loaded = held_megabytes()
        frame = self._make_frame(self.seed, "default p")
        fitted = peak_megabytes()
        prepare(frame()).solve(max_iterations=30)
        figures = {"libraries [MB]": loaded, "peak of the fit [MB]": fitted, "peak [MB]": peak_megabytes()}
        return {"rows": [{"what": what, "value": value} for what, value in figures.items()]}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that frames are right to 0.01 mm, and fast and small enough."""
        gates: list[dict] = []
        for row in rows:
            lines = row.values["rows"]
            if row.case == COLD:
                slowest = float(np.max([line["seconds"] for line in lines]))
                mean = 3600.0 / float(np.mean([line["seconds"] for line in lines]))
                gates += [
                    at_most(f"cold frame, {row.method}: slowest, scene to solution [s]", slowest, 1.0,
                            answer=False),
                    at_least(f"cold frames per core-hour, {row.method}", mean, 4000, answer=False),
                    at_most(f"cold frame, {row.method}: largest error [mm]",
                            float(np.max([line["error_mm"] for line in lines])), ACCURACY),
                    at_most(f"cold frames, {row.method}: not converged", count_unfinished(lines), 0),
                ]  # fmt: skip
            elif row.case == SEQUENCE:
                (line,) = lines
                median = float(np.median(line["solve_s"]))
                gates += [
                    at_most("warm frame of a sequence, median [s]", median, 0.2, answer=False),
                    at_least("warm frames per core-hour", line["per_hour"], 15000, answer=False),
                    at_most("warm frame: largest error [mm]", line["error_mm"], ACCURACY),
                ]
            else:
                gates.append(at_most("memory of a worker, fit and frame [MB]", lines[-1]["value"], 600.0))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell frames per hour."""
        sentences = []
        for row in rows:
            if row.case == COLD:
                mean = 3600.0 / float(np.mean([line["seconds"] for line in row.values["rows"]]))
                sentences.append(f"{mean:,.0f} cold frames of {row.method}")
            elif row.case == SEQUENCE:
                sentences.append(f"{row.values['rows'][0]['per_hour']:,.0f} frames of a sequence")
        return f"A core simulates, per hour, {', '.join(sentences)}." if sentences else ""
