"""One solver on one problem: another package's in a process of its own, ours in this one, and what its lines say."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from ....lhm.base.errors import MissingDependencyError, SoftdecaError
from ....lhm.base.mesh import Floats
from ....reference import prepare
from ....reference.added import NotModelledError
from .problems import Problem
from .solvers.protocol import ArenaProblem, Clock

ACCURACIES = (1.0, 0.1, 0.01, 0.001)
"""[mm] of the largest error on the skin."""
POINTS = 40
"""Of a curve that are kept at most, evenly in the logarithm of the time."""
SET_UP_LIMIT = 240
"""[s] of processor time that imports, set-up and compilation may take together, beside twice the budget."""
GRACE = 6.0
"""[s] of processor time that a solve which cannot look at the clock may take beside twice its budget."""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "IGL", "VECLIB_MAXIMUM")


@dataclass(frozen=True)
class Lines:
    """What a run wrote, a mapping per line, and how its process ended: "" where it ended by itself."""

    lines: Sequence[Mapping[str, Any]]
    ended: str = ""

    def find(self, key: str, otherwise: Any = None) -> Any:
        """Give the first value of a key."""
        return next((line[key] for line in self.lines if key in line), otherwise)


def find_python(solver: str) -> str:
    """Give the interpreter of a solver: of its own environment where there is one, else the one that runs this."""
    own = environments() / Path(solver).stem / "bin" / "python"
    return str(own) if own.exists() else sys.executable


def environments() -> Path:
    """Give the folder of environments by solver: SOFTDECA_ARENA, or one in the user's cache."""
    return Path(os.environ.get("SOFTDECA_ARENA") or platformdirs.user_cache_path("softdeca") / "arena")


def run_outside(
    solver: str, arrays: ArenaProblem, answers: Mapping[str, Floats], settings: Mapping[str, Any], budget: float
) -> Lines:
    """Run a solver's file (a name in `solvers`, or a path) in a process of its own, on one thread.

    answers: "own" and "neo" [mm], (n, 3); budget: processor time [s] of the solve. The process is ended where it takes
    twice that beside its set-up's limit.
    """
    limit = int(2 * budget + SET_UP_LIMIT)
    with tempfile.TemporaryDirectory() as folder:
        problem, order, out = (Path(folder) / name for name in ("problem.npz", "order.json", "out.jsonl"))
        np.savez(problem, **asdict(arrays), **{f"answer_{name}": answer for name, answer in answers.items()})
        order.write_text(json.dumps({"settings": settings, "budget_s": budget, "limit_s": limit}))
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
        pinned = {f"{name}_NUM_THREADS": "1" for name in THREADS}
        command = [find_python(solver), "-m", "solvers", solver, str(problem), str(order), str(out)]
        with open(Path(folder) / "words", "w+") as words:
            process = subprocess.Popen(
                command, cwd=folder, env={**os.environ, **pinned, "PYTHONPATH": path}, stdout=words, stderr=words
            )
            ended = _wait(process, out, budget, 8 * limit)
            words.seek(0)
            last = (words.read().strip().splitlines() or [""])[-1]
        lines = [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []
        if process.returncode and not ended:
            ended = f"its process ended with {process.returncode}: {last}"
    return Lines(lines, ended)


def _wait(process: subprocess.Popen, out: Path, budget: float, limit: float) -> str:
    """Wait for the end of a run; kill it where its solve has long spent its budget; the reason, or ""."""
    begin, solving, spent = time.monotonic(), 0.0, 0.0
    while process.poll() is None:
        time.sleep(0.2)
        used = _processor_time(process.pid)
        if not solving and out.exists() and '"set-up"' in out.read_text():
            solving = used
        spent = used - solving if solving else 0.0
        if spent > 2 * budget + GRACE or time.monotonic() - begin > limit:
            process.kill()
            process.wait()
            return f"no end in {spent:.0f} s" if solving else f"no end of its set-up in {used:.0f} s"
    return ""


def _processor_time(pid: int) -> float:
    """Processor time [s] of a process so far; 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run_own(
    problem: Problem, law: str, start: Floats | None, answers: Mapping[str, Floats], budget: float, **how: Any
) -> Lines:
    """Run a solver of `softdeca.reference.prepare` by its options `how`, in this process.

    It is prepared twice: what the first time takes more is compilation.
    """
    scene, out = problem.scene(law), io.StringIO()
    clock = Clock(problem.arrays(start), answers, budget, out)
    prepare(scene, **how).solve(max_iterations=1)
    clock.end("compilation")
    prepared = prepare(scene, **how)
    clock.end("set-up")

    def see(iteration: int, positions: Floats, energy: float, gradient_norm: float) -> bool:
        return not clock.see(positions, iteration)

    solution = prepared.solve(start=start, tolerance=1e-10, on_iteration=see)
    clock.see(solution.positions, solution.iterations)
    return Lines([json.loads(line) for line in out.getvalue().splitlines()], "" if solution.converged else
                 f"{solution.reason.name.lower()}")  # fmt: skip


def check(lines: Lines, title: str, pins: Sequence[str]) -> None:
    """Raise MissingDependencyError for absent packages, NotModelledError for a problem that was refused."""
    if missing := lines.find("missing"):
        names = " ".join(pin for pin in pins if pin.partition("==")[0] in missing)
        raise MissingDependencyError(f"{title}: not installed; pip install {names}, or see docs/arena.md")
    if refused := lines.find("refused"):
        raise NotModelledError(f"{title}: {refused}")
    if not lines.lines:
        raise SoftdecaError(f"{title}: {lines.ended or 'it wrote nothing'}")


def summarise(lines: Lines) -> dict[str, Any]:
    """Give a row's values: phases, times to accuracies, the error at the end and the curve."""
    phases = {line["phase"]: line["cpu_s"] for line in lines.lines if "phase" in line}
    trace = [line for line in lines.lines if "own" in line]
    values: dict[str, Any] = {
        "imports_s": phases.get("imports", 0.0),
        "compile_s": phases.get("compilation", 0.0),
        "set_up_s": phases.get("set-up", 0.0),
        "peak_mb": lines.find("peak_mb"),
        "ended": lines.ended or lines.find("error") or "",
        "versions": ", ".join(f"{name} {number}" for name, number in lines.find("versions", {}).items()),
    }
    if not trace:
        return values | {"error_mm": [], "seconds": [], "max_mm": None, "mean_mm": None}
    seconds, largest = [line["cpu_s"] for line in trace], [line["own"][1] for line in trace]
    kept = _thin(seconds)
    return values | {
        "solve_s": seconds[-1],
        "wall_s": trace[-1]["wall_s"],
        "work": trace[-1]["work"],
        "first_mm": largest[0],
        "mean_mm": trace[-1]["own"][0],
        "max_mm": largest[-1],
        "floor_mm": min(largest),
        "neo_max_mm": trace[-1]["neo"][1],
        "seconds_to": [seconds_to(seconds, largest, accuracy) for accuracy in ACCURACIES],
        "seconds": [seconds[k] for k in kept],
        "error_mm": [largest[k] for k in kept],
    }


def seconds_to(seconds: Sequence[float], errors: Sequence[float], accuracy: float) -> float | None:
    """Give the time [s] from which on the error stays at most an accuracy [mm]; None if it does not."""
    above = [k for k, error in enumerate(errors) if not error <= accuracy]
    first = above[-1] + 1 if above else 0
    return seconds[first] if first < len(seconds) else None


def _thin(seconds: Sequence[float]) -> Iterable[int]:
    """Choose points of a curve: the first, the last, and some evenly in the logarithm of time."""
    grid = np.geomspace(max(seconds[-1] * 1e-3, 1e-4), max(seconds[-1], 1e-3), POINTS)
    return sorted({0, len(seconds) - 1, *np.minimum(np.searchsorted(seconds, grid), len(seconds) - 1).tolist()})
