"""FEniCSx' phases on one scene by counts of processes of mpirun: seconds of each, and whether their answers agree.

Every count of processes has its turn in each round, and a phase's seconds are the least of all its repeats, so that
what else runs on the machine spoils little.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ....lhm.base.errors import SoftdecaError
from ....reference import Scene
from ...harness.mpirun import run_by_mpirun
from ...harness.processes import peak_megabytes

PHASES = ("prepare", "energy", "gradient", "hessian", "first_solve", "next_solve", "whole")
TIGHT = 1e-12


def compare_phases(scene: Scene, counts: Sequence[int], rounds: int, repeats: int) -> list[dict]:
    """Compare a scene by each count of processes: seconds of phases, and how far its answer is from one process'.

    Raises MissingDependencyError where there is no mpirun, SoftdecaError where its processes fail.
    """
    lines: dict[int, dict] = {}
    for _ in range(rounds):
        for count in counts:
            now = run_by_mpirun(count, measure, scene, repeats)
            best = lines.get(count, now)
            lines[count] = now | {phase: min(best[phase], now[phase]) for phase in PHASES}
    alone = lines[1]["positions"]
    largest = float(np.linalg.norm(alone - scene.vertices, axis=1).max())
    rows = []
    for count, result in lines.items():
        off = float(np.abs(result.pop("positions") - alone).max()) / largest
        gain = lines[1]["whole"] / result["whole"]
        rows.append({"tets": len(scene.tets), "processes": count, **result, "gain": gain, "off": off})
    return rows


def measure(scene: Scene, repeats: int) -> dict:
    """Measure seconds of each phase (the least of some repeats) and the answer, by all processes of mpirun.

    energy, gradient and hessian are those of a state near rest; first_solve makes multigrid's levels and solves one
    system, next_solve solves another with new values; whole is a solve to TIGHT of a prepared scene. peak_mb is of the
    largest process.
    """
    from ....reference.fenicsx import prepare
    from ....reference.fenicsx.dolfinx_version import ALL
    from ....reference.fenicsx.linear.problem import Problem
    from ....reference.fenicsx.linear.solvers import LINEAR_SOLVERS, hold
    from ....reference.fenicsx.mesh.numbering import Numbering, ranks_for

    prepare(scene).solve(max_iterations=1)  # compiles
    times: dict[str, list[float]] = {phase: [] for phase in PHASES}
    order = Numbering(scene, comm=ranks_for(scene))
    problem = Problem(scene, order)
    owned = order.nodes.owned
    held = np.flatnonzero((order.held(scene.dirichlet()[0]) | problem.unsupported[:, None])[:owned])
    rng = np.random.default_rng(0)
    for _ in range(repeats):
        seconds, prepared = _time(lambda: prepare(scene))
        times["prepare"].append(seconds)
        u = rng.normal(0.0, 1e-3, (owned, 3))
        u.flat[held] = 0.0
        u = order.nodes.spread(u)
        seconds, state = _time(lambda u=u: problem.at(u))
        times["energy"].append(seconds)
        seconds, gradient = _time(state.gradient)
        times["gradient"].append(seconds)
        solver = LINEAR_SOLVERS["cg"](problem.matrix)
        for phase in ("first_solve", "next_solve"):
            seconds, hessian = _time(lambda state=state: state.hessian(0.0))
            times["hessian"].append(seconds)
            b = -gradient.ravel()
            hold(hessian, held, np.zeros(len(held)), b)
            seconds, answer = _time(lambda solver=solver, b=b: solver.solve(b, relative=1e-6))
            if not answer.converged:
                raise SoftdecaError(f"the linear system near rest is not solved: {answer.why}")
            times[phase].append(seconds)
    for _ in range(max(1, repeats // 2)):
        seconds, solution = _time(lambda: prepared.solve(tolerance=TIGHT))
        times["whole"].append(seconds)
    return {
        **{phase: min(values) for phase, values in times.items()},
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
