"""Run one solver's file on one problem: python -m solvers FILE PROBLEM.npz SETTINGS.json OUT.jsonl.

The solver first runs WARM.npz beside the problem, which is not counted. Whoever starts this process ends it: a limit on
its processor time (RLIMIT_CPU) would let `time.process_time` advance by ticks of some milliseconds.
"""

from __future__ import annotations

import importlib
import importlib.util
import io
import json
import resource
import sys
import time
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any, TextIO

import numpy as np

from .protocol import WARM_BUDGET, ArenaProblem, Clock, RefusalError, SpentError

ANSWERS = "answers"
"""Array (k, n, 3) of a problem's file, of which errors are measured."""
WARM = "warm.npz"
"""File beside a problem's, of the small one that a solver runs first."""


def load(file: str) -> ModuleType:
    """Load a solver's file: one of this folder by its name, or another by its path."""
    if not file.endswith(".py"):
        return importlib.import_module(f".{file}", __package__)
    spec = importlib.util.spec_from_file_location(f"solver_{Path(file).stem}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read_versions(packages: tuple[str, ...]) -> dict[str, str | None]:
    """Give the version of each package, "name==version"; None where it is absent."""
    versions: dict[str, str | None] = {}
    for requirement in packages:
        name = requirement.partition("==")[0]
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return versions


def warm_up(solver: ModuleType, problem: ArenaProblem, settings: Any, out: TextIO) -> None:
    """Run a solver on a small problem; a line of `out` says what it took, with imports."""
    inside = io.StringIO()
    clock = Clock(problem.start, problem.skin, (), WARM_BUDGET, inside)
    begin = time.process_time()
    with suppress(Exception):  # the counted run says what is wrong
        solver.run(problem, settings, clock)
    imports = [line for line in map(json.loads, inside.getvalue().splitlines()) if line.get("phase") == "imports"]
    lines = [*imports[:1], {"phase": "warm-up", "cpu_s": time.process_time() - begin}]
    out.writelines(json.dumps(line) + "\n" for line in lines)


def main(file: str, problem_path: str, settings_path: str, out_path: str) -> None:
    """Run it; lines of JSON in the file at `out_path` say how it went, also where it fails."""
    solver, problem = load(file), ArenaProblem.read(Path(problem_path))
    with np.load(problem_path) as arrays:
        answers = arrays[ANSWERS]
    order = json.loads(Path(settings_path).read_text())
    with open(out_path, "w", buffering=1) as out:  # a run that is killed leaves its lines
        versions = read_versions(solver.PACKAGES)
        out.write(json.dumps({"versions": versions}) + "\n")
        missing = [name for name, version in versions.items() if version is None]
        if missing:
            out.write(json.dumps({"missing": missing}) + "\n")
            return
        try:
            problem.check_taken(getattr(solver, "TAKES", ()))
            warm_up(solver, ArenaProblem.read(Path(problem_path).with_name(WARM)), order["settings"], out)
            clock = Clock(problem.start, problem.skin, answers, order["budget_s"], out)
            solver.run(problem, order["settings"], clock)
        except RefusalError as refusal:
            out.write(json.dumps({"refused": str(refusal)}) + "\n")
        except SpentError:
            pass
        except Exception as error:
            out.write(json.dumps({"error": f"{type(error).__name__}: {error}"}) + "\n")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
        out.write(json.dumps({"peak_mb": peak}) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
