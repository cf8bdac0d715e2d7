"""How time and memory of FEniCSx fall with processes that read a mesh together, at one size and at one size each.

A block of rubber, held below and pulled and sheared above, of as many unknowns as asked. Strong scaling is one block by
1, 2, ... processes, weak scaling a block for each count whose unknowns grow with it. Seconds are processor time, the
largest process' and all together, so that what else runs on the machine spoils little.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....reference import solve, terms
from ....reference.materials import NeoHookean
from ...harness.mpirun import run_by_mpirun
from ...harness.processes import held_megabytes, peak_megabytes
from ...harness.study import Column, Row, Study, Task, Values
from .ranks import gate_agreement, parse_counts

STRONG, WEAK = "strong", "weak"
TOLERANCE = 1e-12
FEWEST = 3000  # unknowns


@dataclass(frozen=True)
class Parts(Study):
    """Counts of processes, the first of which is 1, and sizes of the block."""

    name = "parts"
    heading = "Do more processes need less memory each?"
    question = "How do time and memory fall with the number of processes, where none holds the whole mesh?"
    columns = (
        Column("processes", "processes"),
        Column("unknowns", "unknowns"),
        Column("seconds", "wall clock [s]", cost=True),
        Column("cpu_s", "processor time, largest process [s]", cost=True),
        Column("all_cpu_s", "of all [s]", cost=True),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("empty_mb", "largest process before [MB]", cost=True),
        Column("peak_mb", "the largest process [MB]", cost=True),
        Column("off", "off one process' answer, of the largest displacement"),
    )
    note = (
        "Neo-Hookean, Poisson's ratio .45, linear tets. Reading, preparation and solve to a gradient norm of 1e-12 of "
        "its start, compiled before. The system counts a process that waits for others as working. All gather the "
        "answer afterwards, to compare it."
    )
    timed = True
    alone = True

    processes: tuple[str, ...] = option(
        ("1", "2", "4"), "counts to compare, the first is 1; repeat", name="--processes"
    )
    unknowns: tuple[str, ...] = option(("65000", "290000"), "of a block, about; repeat", name="--unknowns")

    def tasks(self) -> Sequence[Task]:
        """List strong scaling at each size, weak scaling at the first per process; InputError for bad options."""
        counts = parse_counts(self.processes)
        if not self.unknowns or not all(text.isdecimal() and int(text) >= FEWEST for text in self.unknowns):
            raise InputError(f"unknowns: expected {FEWEST} or more each, got {', '.join(self.unknowns) or 'none'}")
        method = f"{', '.join(map(str, counts))} processes"
        strong = [Task(f"{STRONG}, {size} unknowns", method) for size in self.unknowns]
        return [*strong, Task(f"{WEAK}, {self.unknowns[0]} unknowns each", method)]

    def measure(self, task: Task) -> Values:
        """Measure a row per count of processes."""
        kind, size = task.case.split(", ")
        return {"rows": compare_counts(parse_counts(self.processes), int(size.split()[0]), each=kind == WEAK)}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all agree and converge."""
        return gate_agreement(rows)

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what the most processes gain."""
        sentences = []
        for row in rows:
            first, last = row.values["rows"][0], row.values["rows"][-1]
            sentences.append(
                f"{row.case.capitalize()}: the largest of {last['processes']} processes holds {last['peak_mb']:.0f} MB "
                f"and works {last['cpu_s']:.1f} s, one alone {first['peak_mb']:.0f} MB and {first['cpu_s']:.1f} s."
            )
        return " ".join(sentences)


def compare_counts(counts: Sequence[int], unknowns: int, *, each: bool) -> list[dict]:
    """Compare a block by each count of processes; `each` of them has so many unknowns, or all together.

    Raises MissingDependencyError where there is no mpirun, SoftdecaError where its processes fail.
    """
    rows: list[dict] = []
    first = None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "block.xdmf"
        for count in counts:
            if each or not rows:
                run_by_mpirun(1, write_block_file, file, count_cells(unknowns * (count if each else 1)))
            found = run_by_mpirun(count, measure, file)
            positions, moved = found.pop("positions"), found.pop("moved")
            first = positions if first is None else first
            off = None if each and rows else float(np.abs(positions - first).max()) / moved
            rows.append({"processes": count, **found, "off": off})
    return rows


def count_cells(unknowns: int) -> int:
    """Count how many cells a block has along each edge, for about so many unknowns."""
    return round((unknowns / 3.0) ** (1 / 3)) - 1


def make_terms(part) -> list[terms.Term]:
    """Make what acts on the unit block: held below, pulled and sheared above."""
    height = part.vertices[:, 2]
    low, high = np.flatnonzero(height < 1e-9), np.flatnonzero(height > 1.0 - 1e-9)
    return [
        terms.Hyperelastic(NeoHookean.from_young(10.0, 0.45)),
        terms.Fixed(low),
        terms.Fixed(high, part.vertices[high] + [0.1, 0.05, 0.2]),
    ]


def write_block_file(file: Path, cells: int) -> dict:
    """Write a block of so many cells along an edge to XDMF with HDF5."""
    from ....reference.fenicsx.dolfinx_version import write_block

    write_block(file, cells)
    return {}


def measure(file: Path) -> dict:
    """Read the block, prepare and solve it by all processes of mpirun: what that takes, and the answer."""
    from ....reference.fenicsx import read_scene
    from ....reference.fenicsx.dolfinx_version import ALL, write_block

    small = file.with_name("small.xdmf")
    if ALL.rank == 0:
        write_block(small, 3 + ALL.size)
    ALL.Barrier()
    solve(read_scene(small, make_terms), solver="fenicsx", max_iterations=1)  # compiles
    empty = held_megabytes()
    ALL.Barrier()
    begin, worked = time.perf_counter(), time.process_time()
    scene = read_scene(file, make_terms)
    solution = solve(scene, solver="fenicsx", tolerance=TOLERANCE)
    spent, seconds = time.process_time() - worked, time.perf_counter() - begin
    peaks = ALL.allgather((spent, empty, peak_megabytes()))
    positions, rest = scene.whole(solution.positions), scene.whole(scene.vertices)
    return {
        "unknowns": 3 * len(positions),
        "seconds": seconds,
        "cpu_s": max(cpu for cpu, _, _ in peaks),
        "all_cpu_s": sum(cpu for cpu, _, _ in peaks),
        "iterations": solution.iterations,
        "linear_iterations": solution.detail["linear_iterations"],
        "converged": solution.converged,
        "empty_mb": max(before for _, before, _ in peaks),
        "peak_mb": max(most for _, _, most in peaks),
        "moved": float(np.abs(positions - rest).max()),
        "positions": positions,
    }
