"""What several processes gain: FEniCSx's phases on one head by 1, 2, ... processes of mpirun, and whether they agree.

Every count of processes has its turn in each round, and a phase's seconds are the least of all its repeats, so that
what else runs on the machine spoils little. `megabytes` is the largest process' resident memory at its peak.
"""

from __future__ import annotations

import os
import pickle
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..lhm import expressions
from ..lhm.errors import InputError, MissingDependencyError, SoftdecaError
from ..lhm.progress import OnProgress
from ..reference import Parameters, Scene, facial_scene, neo_hookean_scene, ranks
from . import machine
from .gates import at_most
from .throughput import default_head

PHASES = ("prepare", "energy", "gradient", "hessian", "first_solve", "next_solve", "whole")
RELATIVE = 1e-6  # of a linear system's right-hand side
TIGHT = 1e-12
AGREEMENT = 1e-10  # of the largest displacement
START = "from softdeca.benchmarks.ranks import measure_here; measure_here()"
SETTINGS = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMPI_MCA_orte_execute_quiet": "1"}
ENERGIES = ("neo-Hookean", "PD")


@dataclass(frozen=True)
class RanksConfig:
    """How many processes to compare, the first count alone; how many rounds, and repeats of a phase in each.

    Raises InputError for counts that do not begin with 1 or an expression that cannot be read.
    """

    counts: tuple[int, ...] = (1, 2)
    expression: str = "jawOpen*0.5"
    level: int = 2
    rounds: int = 2
    repeats: int = 5

    def __post_init__(self):
        if not self.counts or self.counts[0] != 1 or min(self.counts) < 1:
            raise InputError(f"counts of processes: expected 1 and others, got {self.counts}")
        expressions.parsed(self.expression)


def run_ranks(config: RanksConfig, progress: OnProgress) -> dict:
    """Measure both energies of the default head; `rows` by energy and count, and gates.

    Raises MissingDependencyError where there is no mpirun, SoftdecaError where its processes fail.
    """
    progress("ranks: the head", 0.0)
    space, code, head = default_head(level=config.level)
    targets = expressions.blend(space, code, expressions.parsed(config.expression))[0]
    scene = facial_scene(head, Parameters(), targets, bones="prescribed")
    scenes = dict(zip(ENERGIES, (neo_hookean_scene(scene), scene), strict=True))
    return compare(scenes, config, progress)


def compare(scenes: Mapping[str, Scene], config: RanksConfig, progress: OnProgress) -> dict:
    """The same for any scenes, by name."""
    if shutil.which("mpirun") is None:
        raise MissingDependencyError("mpirun is not installed; Debian: apt-get install openmpi-bin")
    rows: list[dict] = []
    for i, (name, scene) in enumerate(scenes.items()):
        told = {"name": name, "vertices": len(scene.vertices), "tets": len(scene.tets)}
        found: dict[int, dict] = {}
        for turn in range(config.rounds):
            for count in config.counts:
                progress(f"ranks: {name}, {count} processes", (i + turn / config.rounds) / len(scenes))
                found[count] = _best(found.get(count), _spawned(count, scene, config.repeats))
        alone = found[1]["positions"]
        largest = float(np.linalg.norm(alone - scene.vertices, axis=1).max())
        for count, result in found.items():
            off = float(np.abs(result.pop("positions") - alone).max()) / largest
            gain = {phase: found[1]["seconds"][phase] / result["seconds"][phase] for phase in PHASES}
            rows.append({**told, "processes": count, **result, "gain": gain, "off": off})
    progress("ranks", 1.0)
    return {"rows": rows, "gates": _gates(rows), "machine": machine.describe()}


def _gates(rows: Sequence[Mapping]) -> list[dict]:
    return [
        at_most("distance to one process' answer, of the largest displacement", max(r["off"] for r in rows), AGREEMENT),
        at_most("solves that did not converge", sum(not row["converged"] for row in rows), 0),
    ]


def _best(before: dict | None, now: dict) -> dict:
    if before is None:
        return now
    return {**now, "seconds": {phase: min(before["seconds"][phase], now["seconds"][phase]) for phase in PHASES}}


def _spawned(count: int, scene: Scene, repeats: int) -> dict:
    """What `measure` says in processes of mpirun, which the system may move between processors."""
    with tempfile.TemporaryDirectory() as folder:
        given, told = Path(folder) / "given", Path(folder) / "told"
        given.write_bytes(pickle.dumps((scene, repeats)))
        command = [
            "mpirun",
            "--bind-to",
            "none",
            "--oversubscribe",
            "-n",
            str(count),
            sys.executable,
            "-c",
            START,
        ]
        outer = {key: value for key, value in os.environ.items() if not key.startswith(ranks.INHERITED)}
        done = subprocess.run([*command, given, told], env={**outer, **SETTINGS}, capture_output=True, text=True)
        if done.returncode != 0:
            why = without_notices(done.stderr).strip().splitlines() or [f"exit status {done.returncode}"]
            raise SoftdecaError(f"mpirun -n {count}: {why[-1]}")
        return pickle.loads(told.read_bytes())


def without_notices(errors: str) -> str:
    """What processes have written to stderr, without mpirun's own notices: between rules, or of processes it ended."""
    said = "".join(re.split(r"^-{70,}\n", errors, flags=re.MULTILINE)[::2])
    return re.sub(r"^\[[^\]\s]+:\d+\] PMIX ERROR: .*\n?", "", said, flags=re.MULTILINE)


def measure_here() -> None:
    """Measure the scene of the file that the command names first, into the one that it names second."""
    given, told = sys.argv[-2:]
    scene, repeats = pickle.loads(Path(given).read_bytes())
    found = measure(scene, repeats)
    from ..reference.fenicsx.dolfinx_version import ALL

    found["megabytes"] = max(ALL.allgather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3))
    if ALL.rank == 0:
        Path(told).write_bytes(pickle.dumps(found))


def measure(scene: Scene, repeats: int) -> dict:
    """Seconds of each phase (the least of some repeats), and the answer, by all processes that mpirun has started.

    energy, gradient and hessian are those of a state near rest; first_solve makes multigrid's levels and solves one
    system, next_solve solves another with new values; whole is a solve to TIGHT of a prepared scene.
    """
    from ..reference.fenicsx import prepare
    from ..reference.fenicsx.linear import LINEAR_SOLVERS, hold
    from ..reference.fenicsx.numbering import Numbering
    from ..reference.fenicsx.prepared import processes_for
    from ..reference.fenicsx.problem import Problem

    prepare(scene).solve(max_iterations=1)  # compiles
    times: dict[str, list[float]] = {phase: [] for phase in PHASES}
    order = Numbering(scene, comm=processes_for(scene))
    problem = Problem(scene, order)
    owned = order.nodes.owned
    held = np.flatnonzero((order.held(scene.dirichlet()[0]) | problem.unsupported[:, None])[:owned])
    rng = np.random.default_rng(0)
    for _ in range(repeats):
        seconds, prepared = _timed(lambda: prepare(scene))
        times["prepare"].append(seconds)
        u = rng.normal(0.0, 1e-3, (owned, 3))
        u.flat[held] = 0.0
        u = order.nodes.spread(u)
        seconds, state = _timed(lambda u=u: problem.at(u))
        times["energy"].append(seconds)
        seconds, gradient = _timed(state.gradient)
        times["gradient"].append(seconds)
        solver = LINEAR_SOLVERS["cg"](problem.matrix)
        for phase in ("first_solve", "next_solve"):
            seconds, hessian = _timed(lambda state=state: state.softened_hessian(0.0))
            times["hessian"].append(seconds)
            b = -gradient.ravel()
            hold(hessian, held, np.zeros(len(held)), b)
            seconds, answer = _timed(lambda solver=solver, b=b: solver.solve(b, relative=RELATIVE))
            if not answer.found:
                raise SoftdecaError(f"the linear system near rest is not solved: {answer.why}")
            times[phase].append(seconds)
    for _ in range(max(1, repeats // 2)):
        seconds, solution = _timed(lambda: prepared.solve(tolerance=TIGHT))
        times["whole"].append(seconds)
    return {
        "seconds": {phase: min(found) for phase, found in times.items()},
        "iterations": solution.iterations,
        "linear_iterations": solution.detail["linear_iterations"],
        "converged": solution.converged,
        "positions": solution.positions,
    }


def _timed(work: Callable):
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result
