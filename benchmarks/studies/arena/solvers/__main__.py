"""Run one solver's file on one problem: python -m solvers FILE PROBLEM.npz SETTINGS.json OUT.jsonl."""

from __future__ import annotations

import importlib
import importlib.util
import json
import resource
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

import numpy as np

from .protocol import ArenaProblem, Clock, RefusalError, SpentError

ANSWER = "answer_"
"""How arrays of a problem's file begin that are answers."""


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


def main(file: str, problem_path: str, settings_path: str, out_path: str) -> None:
    """Run it; lines of JSON in the file at `out_path` say how it went, also where it fails."""
    solver, problem = load(file), ArenaProblem.read(Path(problem_path))
    with np.load(problem_path) as arrays:
        answers = {name.removeprefix(ANSWER): arrays[name] for name in arrays if name.startswith(ANSWER)}
    order = json.loads(Path(settings_path).read_text())
    limit = int(order["limit_s"])
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
    with open(out_path, "w") as out:
        versions = read_versions(solver.PACKAGES)
        out.write(json.dumps({"versions": versions}) + "\n")
        missing = [name for name, version in versions.items() if version is None]
        if missing:
            out.write(json.dumps({"missing": missing}) + "\n")
            return
        try:
            problem.check_taken(getattr(solver, "TAKES", ()))
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
