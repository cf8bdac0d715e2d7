"""Gain of several processes of mpirun: whole solves of one head by FEniCSx."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....reference import Parameters, Scene, apply_law, facial_scene
from ....reference.face.facial import PD_ENERGY
from ...harness.mpirun import run_by_mpirun
from ...harness.processes import peak_megabytes
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import largest_distance
from ..person import OfPerson

TIGHT = 1e-12


@dataclass(frozen=True)
class Ranks(OfPerson):
    """Counts of processes, the first of which is 1, on both energies of one head."""

    name = "ranks"
    question = "What do several processes gain?"
    columns = (
        Column("processes", "processes"),
        Column("tets", "tets"),
        Column("prepare", "prepare [s]", cost=True),
        Column("whole", "whole solve [s]", cost=True),
        Column("gain", "whole: times as fast as one process"),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("off", "off one process' answer, of the largest displacement"),
        Column("peak_mb", "the largest process [MB]", cost=True),
    )
    note = "All solves end at a gradient norm of 1e-12 of their start. Seconds are the least of the repeats."
    timed = True

    processes: tuple[int, ...] = option((1, 2), "counts, the first is 1; repeat", name="--processes", type=int)
    expression: str = "jawOpen*0.5"
    repeats: int = 5

    def tasks(self) -> Sequence[Task]:
        """List an energy of the head each; InputError for counts that do not begin with 1."""
        self.check([self.expression])
        if self.processes[:1] != (1,) or min(self.processes) < 1:
            raise InputError(f"processes: expected 1 and others, got {self.processes}")
        return [Task(law, f"{', '.join(map(str, self.processes))} processes") for law in ("neo-Hookean", PD_ENERGY)]

    def measure(self, task: Task) -> Values:
        """Measure a row per count of processes; SoftdecaError where there is no mpirun, or its processes fail."""
        person = self.person()
        scene = facial_scene(person.head, Parameters(), person.shape(self.expression), bones="prescribed")
        scene = apply_law(scene, task.case)
        lines = {count: run_by_mpirun(count, measure, scene, self.repeats) for count in self.processes}
        alone, whole = lines[1]["positions"], lines[1]["whole"]
        largest = largest_distance(alone, scene.vertices)
        for count, line in lines.items():
            off = float(np.abs(line.pop("positions") - alone).max()) / largest
            line |= {"tets": len(scene.tets), "processes": count, "gain": whole / line["whole"], "off": off}
        return {"rows": list(lines.values())}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that there is one answer, and that all converged."""
        lines = [line for row in rows for line in row.values["rows"]]
        what = "distance to one process' answer, of the largest displacement"
        return [
            at_most(what, max(line["off"] for line in lines), 1e-10),
            at_most("solves that did not converge", sum(not line["converged"] for line in lines), 0),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what a whole solve gains."""
        return " ".join(
            f"{row.case}: {line['processes']} processes solve {line['gain']:.2f} times as fast as one."
            for row in rows
            for line in row.values["rows"][1:]
        )


def measure(scene: Scene, repeats: int) -> dict:
    """Measure the least seconds of a preparation and of a whole solve to TIGHT, by all processes of mpirun."""
    from ....reference.fenicsx import prepare
    from ....reference.fenicsx.dolfinx_version import ALL

    prepare(scene).solve(max_iterations=1)  # compiles
    laps = []
    for _ in range(repeats):
        begin = time.perf_counter()
        prepared = prepare(scene)
        ready = time.perf_counter()
        solution = prepared.solve(tolerance=TIGHT)
        laps.append((ready - begin, time.perf_counter() - ready))
    return {
        "prepare": min(prepare for prepare, _ in laps),
        "whole": min(whole for _, whole in laps),
        "iterations": solution.iterations,
        "linear_iterations": solution.detail["linear_iterations"],
        "converged": solution.converged,
        "positions": solution.positions,
        "peak_mb": max(ALL.allgather(peak_megabytes())),
    }
