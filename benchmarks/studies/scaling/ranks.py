"""What several processes of mpirun gain: whole solves of one head by FEniCSx.

Every count of processes has its turn in each round, and the least of all repeats counts, so that what else runs on the
machine spoils little.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....reference import Parameters, Scene, apply_law, facial_scene
from ...harness.mpirun import run_by_mpirun
from ...harness.processes import peak_megabytes
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import NEO_HOOKEAN, PD_ENERGY
from ..person import OfPerson

TIMES = ("prepare", "whole")
TIGHT = 1e-12


@dataclass(frozen=True)
class Ranks(OfPerson):
    """Counts of processes, the first of which is 1, on both energies of one head."""

    name = "ranks"
    heading = "What do several processes gain?"
    question = "How does FEniCSx' time fall with the number of processes of mpirun, and do their answers agree?"
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
    note = "All solves end at a gradient norm of 1e-12 of their start."
    timed = True

    processes: tuple[int, ...] = option(
        (1, 2, 4), "counts to compare, the first is 1; repeat", name="--processes", type=int
    )
    expression: str = "jawOpen*0.5"
    rounds: int = 2
    repeats: int = 5

    def tasks(self) -> Sequence[Task]:
        """List an energy of the head each; InputError for counts that do not begin with 1."""
        self.check([self.expression])
        if self.processes[:1] != (1,) or min(self.processes) < 1:
            raise InputError(f"processes: expected 1 and others, got {self.processes}")
        return [Task(case, f"{', '.join(map(str, self.processes))} processes") for case in (NEO_HOOKEAN, PD_ENERGY)]

    def measure(self, task: Task) -> Values:
        """Measure a row per count of processes."""
        person = self.person()
        scene = facial_scene(person.head, Parameters(), person.shape(self.expression), bones="prescribed")
        scene = apply_law(scene, "neo-Hookean") if task.case == NEO_HOOKEAN else scene
        return {"rows": compare_counts(scene, self.processes, self.rounds, self.repeats)}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that there is one answer, and that all converged."""
        lines = [line for row in rows for line in row.values["rows"]]
        what = "distance to one process' answer, of the largest displacement"
        return [
            at_most(what, max(line["off"] for line in lines), 1e-10),  # of the largest displacement
            at_most("solves that did not converge", sum(not line["converged"] for line in lines), 0),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what a whole solve gains."""
        return " ".join(
            f"{row.case}: {line['processes']} processes solve {line['gain']:.2f} times as fast as one."
            for row in rows
            for line in row.values["rows"][1:]
        )


def compare_counts(scene: Scene, counts: Sequence[int], rounds: int, repeats: int) -> list[dict]:
    """Compare a scene by each count of processes: seconds, and how far its answer is from one process'.

    Raises MissingDependencyError where there is no mpirun, SoftdecaError where its processes fail.
    """
    lines: dict[int, dict] = {}
    for _ in range(rounds):
        for count in counts:
            now = run_by_mpirun(count, measure, scene, repeats)
            best = lines.get(count, now)
            lines[count] = now | {key: min(best[key], now[key]) for key in TIMES}
    alone = lines[1]["positions"]
    largest = float(np.linalg.norm(alone - scene.vertices, axis=1).max())
    rows = []
    for count, result in lines.items():
        off = float(np.abs(result.pop("positions") - alone).max()) / largest
        gain = lines[1]["whole"] / result["whole"]
        rows.append({"tets": len(scene.tets), "processes": count, **result, "gain": gain, "off": off})
    return rows


def measure(scene: Scene, repeats: int) -> dict:
    """Measure the least seconds of a preparation and of a whole solve to TIGHT, by all processes of mpirun.

    peak_mb is of the largest process.
    """
    from ....reference.fenicsx import prepare
    from ....reference.fenicsx.dolfinx_version import ALL

    prepare(scene).solve(max_iterations=1)  # compiles
    preparations = [_time(lambda: prepare(scene)) for _ in range(repeats)]
    prepared = preparations[-1][1]
    solves = [_time(lambda: prepared.solve(tolerance=TIGHT)) for _ in range(max(1, repeats // 2))]
    solution = solves[-1][1]
    return {
        "prepare": min(seconds for seconds, _ in preparations),
        "whole": min(seconds for seconds, _ in solves),
        "iterations": solution.iterations,
        "linear_iterations": solution.detail["linear_iterations"],
        "converged": solution.converged,
        "positions": solution.positions,
        "peak_mb": max(ALL.allgather(peak_megabytes())),
    }


def _time(work: Callable):
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result
