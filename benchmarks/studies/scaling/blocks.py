"""A block of rubber that processes of mpirun read together: time and memory of each, and whether their answers agree.

The block is held below and pulled and sheared above. Seconds are processor time, the largest process' and all together,
so that what else runs on the machine spoils little.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ....reference import solve, terms
from ....reference.materials import NeoHookean
from ...harness.mpirun import run_by_mpirun
from ...harness.processes import held_megabytes, peak_megabytes

TOLERANCE = 1e-12


def compare_blocks(counts: Sequence[int], unknowns: int, *, each: bool) -> list[dict]:
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
