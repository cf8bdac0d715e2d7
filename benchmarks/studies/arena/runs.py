"""One solver on one problem: another package's in a process of its own, ours in this one, and what its lines say."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from ....lhm.base.errors import MissingDependencyError, SoftdecaError
from ....lhm.base.mesh import Floats
from ....reference import prepare
from ....reference.added import NotModelledError
from ..measures import find_arrival
from .entrants import Entrant
from .problems import Problem
from .solvers.__main__ import ANSWERS, WARM
from .solvers.protocol import Clock

ACCURACIES = tuple(float(f"1e-{power}") for power in range(7))
"""[mm] of the largest error."""
ONE, TENTH, HUNDREDTH = range(3)
POINTS = 60
"""Maximum points per curve, log-spaced."""
BUDGETS = ((20_000, 4.0), (100_000, 8.0), (1_000_000, 32.0))
"""[s] of processor time of a solve, up to so many tets."""
REST, ANSWER = "from rest", "from the answer"
SET_UP_LIMIT = 240.0
"""[s] of processor time that imports, the uncounted run and set-up may take together."""
GRACE = 6.0
"""[s] of processor time of compilation, and of a solve that cannot look at the clock, beside twice its budget."""
WALL = 8.0
"""Largest ratio of wall time to processor time of a run."""
WARM_ITERATIONS = 5
"""Iterations of our solvers' uncounted first run."""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "IGL", "VECLIB_MAXIMUM")


@dataclass(frozen=True)
class Lines:
    """Output of a run, a mapping per line, and how its process ended: "" where it ended by itself."""

    lines: Sequence[Mapping[str, Any]]
    ended: str = ""

    def find(self, key: str, otherwise: Any = None) -> Any:
        """Give the first value of a key."""
        return next((line[key] for line in self.lines if key in line), otherwise)


def find_python(solver: str) -> str:
    """Give the interpreter of a solver: of its own environment where there is one, else the one that runs this."""
    interpreter = environments() / Path(solver).stem / "bin" / "python"
    return str(interpreter) if interpreter.exists() else sys.executable


def environments() -> Path:
    """Give the folder of environments by solver: SOFTDECA_ARENA, or one in the user's cache."""
    return Path(os.environ.get("SOFTDECA_ARENA") or platformdirs.user_cache_path("softdeca") / "arena")


def run(
    entrant: Entrant, problem: Problem, law: str, answers: Sequence[Floats], budget: float, start: Floats
) -> dict[str, Any]:
    """Give the values of a row: a solver, with its setting, on a problem of a law, from a start [mm], (n, 3).

    answers [mm], (n, 3) each: where an energy has several minima, errors are to the one at which the solver ends.
    budget: processor time [s] of the solve. Raises MissingDependencyError for absent packages, NotModelledError for a
    problem that is refused.
    """
    runner = run_outside if entrant.file else run_own
    values = summarise(runner(entrant, problem, law, answers, budget, start))
    about = {"solver": entrant.solver, "setting": entrant.setting, "law": law, "dtype": entrant.dtype}
    told = ", ".join(f"{name}={value}" for name, value in entrant.options.items())
    return {**about, "settings": told, "budget_s": budget, **values}


def run_outside(
    entrant: Entrant, problem: Problem, law: str, answers: Sequence[Floats], budget: float, start: Floats
) -> Lines:
    """Run a solver's file in a process of its own, on one thread; see `run`.

    It runs a small problem first, which is not counted. The process is ended where its solve takes twice the budget and
    GRACE, or what comes before SET_UP_LIMIT.
    """
    with tempfile.TemporaryDirectory() as folder:
        arrays, order, out = (Path(folder) / name for name in ("problem.npz", "order.json", "out.jsonl"))
        np.savez(arrays, **asdict(problem.arrays(start)), **{ANSWERS: np.stack(answers)})
        np.savez(arrays.with_name(WARM), **asdict(problem.warm.arrays()))
        order.write_text(json.dumps({"settings": entrant.options, "budget_s": budget}))
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
        pinned = {f"{name}_NUM_THREADS": "1" for name in THREADS}
        command = [find_python(entrant.file), "-m", "solvers", entrant.file, *map(str, (arrays, order, out))]
        with open(Path(folder) / "words", "w+") as words:
            process = subprocess.Popen(
                command, cwd=folder, env={**os.environ, **pinned, "PYTHONPATH": path}, stdout=words, stderr=words
            )
            ended = _wait(process, out, budget)
            words.seek(0)
            last = (words.read().strip().splitlines() or [""])[-1]
        if process.returncode and not ended:
            ended = f"its process ended with {process.returncode}: {last}"
        lines = Lines([json.loads(line) for line in out.read_text().splitlines()] if out.exists() else [], ended)
    if missing := lines.find("missing"):
        names = " ".join(pin for pin in entrant.packages if pin.partition("==")[0] in missing)
        raise MissingDependencyError(f"{entrant.solver}: not installed; pip install {names}, or see docs/arena.md")
    if refused := lines.find("refused"):
        raise NotModelledError(f"{entrant.solver}: {refused}")
    if not lines.lines:
        raise SoftdecaError(f"{entrant.solver}: {ended or 'it wrote nothing'}")
    return lines


def _wait(process: subprocess.Popen, out: Path, budget: float) -> str:
    """Wait for the end of a run; kill it where it has long spent its time; the reason, or ""."""
    solve = 2 * budget + GRACE
    last, stage, before, most = time.monotonic() + WALL * (SET_UP_LIMIT + solve), "set-up", 0.0, SET_UP_LIMIT
    try:
        while process.poll() is None:
            time.sleep(0.2)
            used = _processor_time(process.pid)
            if stage == "set-up" and out.exists() and '"set-up"' in out.read_text():
                stage, before, most = "solve", used, solve
            if used - before > most or time.monotonic() > last:
                return f"no end of its {stage} in {used - before:.0f} s"
    finally:
        process.kill()
        process.wait()
    return ""


def _processor_time(pid: int) -> float:
    """Processor time [s] of a process so far; 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run_own(
    entrant: Entrant, problem: Problem, law: str, answers: Sequence[Floats], budget: float, start: Floats
) -> Lines:
    """Run a solver of `softdeca.reference.prepare` in this process; see `run`."""
    begin = time.process_time()
    prepare(problem.warm.scene(law), **entrant.options).solve(max_iterations=WARM_ITERATIONS)
    before = {"phase": "warm-up", "cpu_s": time.process_time() - begin}
    scene, out = problem.scene(law), io.StringIO()
    clock = Clock(start, problem.skin, answers, budget, out)
    prepared = prepare(scene, **entrant.options)
    clock.end("set-up")

    def see(iteration: int, positions: Floats, energy: float, gradient_norm: float) -> bool:
        return not clock.see(positions, iteration)

    solution = prepared.solve(start=start, tolerance=1e-10, on_iteration=see)
    clock.see(solution.positions, solution.iterations)
    lines = [before, *map(json.loads, out.getvalue().splitlines())]
    ended = "" if solution.converged else solution.reason.name.lower()
    return Lines([*lines, {"linear_iterations": solution.detail.get("linear_iterations")}], ended)


def find_budget(tets: int) -> float:
    """Find the budget [s] of a solve of so many linear tets."""
    return next(seconds for most, seconds in BUDGETS if tets <= most)


def summarise(lines: Lines) -> dict[str, Any]:
    """Give a row's values: phases, time to accuracies, the error at the end and the curve.

    answer: the number of the answer at which the run ends; errors are to that.
    """
    # Imports are the warm-up's.
    phases = {line["phase"]: line["cpu_s"] for line in reversed(lines.lines) if "phase" in line}
    trace = [line for line in lines.lines if "errors" in line]
    values: dict[str, Any] = {
        "clock_s": lines.find("clock_s"),
        "imports_s": phases.get("imports", 0.0),
        "warm_up_s": phases.get("warm-up"),
        "compile_s": phases.get("compilation", 0.0),
        "set_up_s": phases.get("set-up", 0.0),
        "peak_mb": lines.find("peak_mb"),
        "ended": lines.ended or lines.find("error") or "",
        "versions": ", ".join(f"{name} {number}" for name, number in lines.find("versions", {}).items()),
    }
    if not trace:
        empty: dict[str, Any] = dict.fromkeys(("answer", "max_mm", "mean_mm", "to_tenth_s", "to_hundredth_s"))
        return values | empty | {"error_mm": [], "seconds": []}
    answer = int(np.argmin([largest for _, largest in trace[-1]["errors"]]))
    seconds, largest = [line["cpu_s"] for line in trace], [line["errors"][answer][1] for line in trace]
    arrivals = [find_arrival(largest, accuracy) for accuracy in ACCURACIES]
    reached = [None if k is None else seconds[k] for k in arrivals]
    kept = (np.unique(np.geomspace(1, len(trace), POINTS).round().astype(int)) - 1).tolist()
    return values | {
        "answer": answer,
        "solve_s": seconds[-1],
        "wall_s": trace[-1]["wall_s"],
        "iterations": trace[-1]["work"],
        "linear_iterations": lines.find("linear_iterations"),
        "mean_mm": trace[-1]["errors"][answer][0],
        "max_mm": largest[-1],
        "to_tenth_s": reached[TENTH],
        "to_hundredth_s": reached[HUNDREDTH],
        "seconds_to": reached,
        "seconds": [seconds[k] for k in kept],
        "error_mm": [largest[k] for k in kept],
    }
