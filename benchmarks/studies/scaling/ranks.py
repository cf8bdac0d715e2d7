"""What several processes gain: FEniCSx's phases on one head by 1, 2, ... processes of mpirun, and whether they agree.

Every count of processes has its turn in each round, and a phase's seconds are the least of all its repeats, so that
what else runs on the machine spoils little.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.limits import REPEATS
from ....lhm.base.option import option
from ....reference import Parameters, Scene, apply_law, facial_scene
from ...harness.mpirun import run_by_mpirun
from ...harness.processes import peak_megabytes
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import NEO_HOOKEAN, PD_ENERGY
from ..person import OfPerson

PHASES = ("prepare", "energy", "gradient", "hessian", "first_solve", "next_solve", "whole")
RELATIVE = 1e-6  # of a linear system's right-hand side
TIGHT = 1e-12
AGREEMENT = 1e-10  # of the largest displacement


@dataclass(frozen=True)
class Ranks(OfPerson):
    """Counts of processes, the first of which is 1, on both energies of one head."""

    name = "ranks"
    heading = "How much faster is FEniCSx on several processes?"
    question = "What does FEniCSx gain by several processes of mpirun, phase by phase, and do their answers agree?"
    columns = (
        Column("processes", "processes"),
        Column("tets", "tets"),
        *(Column(phase, f"{phase.replace('_', ' ')} [s]", cost=True) for phase in PHASES),
        Column("gain", "whole: times as fast as one process"),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("off", "off one process' answer, of the largest displacement"),
        Column("peak_mb", "the largest process [MB]", cost=True),
    )
    note = (
        "Energy, gradient and hessian are those of a state near rest. The first solve makes multigrid's levels and "
        "solves one system; the next solves another with new values. Whole is a solve to a gradient norm of 1e-12 of "
        "its start."
    )
    timed = True

    processes: tuple[str, ...] = option(("1", "2"), "counts to compare, the first is 1; repeat", name="--processes")
    expression: str = option("jawOpen*0.5", "as jawOpen*0.5+cheekPuff")
    rounds: int = option(2, "in which every count has its turn", bound=REPEATS)
    repeats: int = option(5, "of a phase in each round", bound=REPEATS)

    @property
    def counts(self) -> tuple[int, ...]:
        """Of processes; InputError for other than 1 and others."""
        return parse_counts(self.processes)

    def tasks(self) -> Sequence[Task]:
        """List an energy each: answers by several counts are compared with that by one."""
        self.check([self.expression])
        if self.rounds < 1 or self.repeats < 1:
            raise InputError(f"rounds: {self.rounds}, repeats: {self.repeats}; expected 1 or more")
        method = f"FEniCSx by {', '.join(map(str, self.counts))} processes"
        return [Task(NEO_HOOKEAN, method), Task(PD_ENERGY, method)]

    def measure(self, task: Task) -> Values:
        """Measure a row per count of processes."""
        of = self.person()
        scene = facial_scene(of.head, Parameters(), of.shape(self.expression), bones="prescribed")
        return {"rows": compare_counts(apply_law(scene, "neo-Hookean") if task.case == NEO_HOOKEAN else scene, self)}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all agree and converge."""
        return gate_agreement(rows)

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what a whole solve gains."""
        return " ".join(
            f"{row.case}: {line['processes']} processes solve {line['gain']:.2f} times as fast as one."
            for row in rows
            for line in row.values["rows"][1:]
        )

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the gain of each phase."""
        figure, axes = subplots(1, len(rows), figsize=(5.2 * len(rows), 3.4), sharey=True, squeeze=False)
        for axis, row in zip(axes[0], rows, strict=True):
            one, *others = row.values["rows"]
            for line in others:
                gains = [one[phase] / line[phase] for phase in PHASES]
                axis.plot(gains, "o-", label=f"{line['processes']} processes")
            axis.set_xticks(range(len(PHASES)), [phase.replace("_", " ") for phase in PHASES], rotation=40, fontsize=8)
            axis.axhline(1.0, color="#bbbbbb", lw=0.8)
            axis.set_title(row.case, fontsize=10)
            axis.legend()
        axes[0][0].set_ylabel("times as fast as one process")
        return {"What several processes gain, phase by phase.": to_svg(figure)}


def gate_agreement(rows: Sequence[Row]) -> list[dict]:
    """Make the gates of lines by counts of processes: one answer, where it was compared, and all converged."""
    lines = [line for row in rows for line in row.values["rows"]]
    what = "distance to one process' answer, of the largest displacement"
    return [
        at_most(what, max(line["off"] for line in lines if line["off"] is not None), AGREEMENT),
        at_most("solves that did not converge", sum(not line["converged"] for line in lines), 0),
    ]


def compare_counts(scene: Scene, study: Ranks) -> list[dict]:
    """Compare a scene by each count of processes: seconds of phases, and how far its answer is from one process'.

    Raises MissingDependencyError where there is no mpirun, SoftdecaError where its processes fail.
    """
    found: dict[int, dict] = {}
    for _ in range(study.rounds):
        for count in study.counts:
            now = run_by_mpirun(count, measure, scene, study.repeats)
            best = found.get(count, now)
            found[count] = now | {phase: min(best[phase], now[phase]) for phase in PHASES}
    alone = found[1]["positions"]
    largest = float(np.linalg.norm(alone - scene.vertices, axis=1).max())
    rows = []
    for count, result in found.items():
        off = float(np.abs(result.pop("positions") - alone).max()) / largest
        gain = found[1]["whole"] / result["whole"]
        rows.append({"tets": len(scene.tets), "processes": count, **result, "gain": gain, "off": off})
    return rows


def parse_counts(texts: Sequence[str]) -> tuple[int, ...]:
    """Counts of processes; InputError for other than 1 and others."""
    wanted = f"processes: expected 1 and others, got {', '.join(texts) or 'none'}"
    if not all(text.isdecimal() for text in texts):
        raise InputError(wanted)
    counts = tuple(map(int, texts))
    if not counts or counts[0] != 1 or min(counts) < 1:
        raise InputError(wanted)
    return counts


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
            seconds, answer = _time(lambda solver=solver, b=b: solver.solve(b, relative=RELATIVE))
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
