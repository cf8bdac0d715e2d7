"""Where and with what a figure was measured."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

DIRTY = "-dirty"
"""At the end of a commit: the code had changes that it does not hold."""
_TEXTS = ("docs", "tests", "tools", "benchmarks/results", "*.md")
"""No figure depends on these; they may change while one is measured."""
_CODE = ("lhm/", "reference/", "surrogate/", "animation/", "benchmarks/", "cli/")
"""Where a file that is not in git is code; elsewhere it is somebody's data."""
_PACKAGES = ("softdeca", "numpy", "scipy", "numba", "cholespy", "scikit-fem", "torch", "anny", "fenics-dolfinx")


def describe_machine() -> dict:
    """Processor, cores, load, versions and commit, for a results file."""
    threads = os.environ.get("OMP_NUM_THREADS", "")
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": read_load(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _PACKAGES},
        "commit": read_commit(),
        "threads": int(threads) if threads.isdecimal() and int(threads) else "default",
    }


def read_load() -> float:
    """Processes that ran, on average over the last minute."""
    return round(os.getloadavg()[0], 2)


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


@cache
def read_commit() -> str:
    """The last commit that changed code, when this process first asked; with DIRTY after it where files differ from it.

    Commits of texts and results alone do not count, so that results of one code have one commit.
    """
    if shutil.which("git") is None:
        return "not known: git is not installed"
    here = Path(__file__).resolve().parents[2]

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=True).stdout.strip()

    try:
        code = [".", *(f":(exclude){name}" for name in _TEXTS)]
        commit = git("log", "-1", "--format=%h", "--abbrev=12", "--", *code)
        lines = git("status", "--porcelain", "--untracked-files=all", "--", *code).splitlines()
        changed = [line for line in lines if not line.startswith("??") or line[3:].startswith(_CODE)]
        return commit + (DIRTY if changed else "")
    except subprocess.CalledProcessError:
        return "not known: no git checkout"


def list_commits(machine: Mapping[str, Any], rows: Iterable[Mapping[str, Any]] = ()) -> list[str]:
    """Name the commit of a machine's description, and those of rows that an earlier run measured."""
    earlier = {str(row["commit"]) for row in rows if row.get("commit")}
    return list(dict.fromkeys([str(machine.get("commit", "")), *sorted(earlier)]))


def is_dirty(commit: str) -> bool:
    """Whether the code had changes that a commit does not hold, so that its figures cannot be made again."""
    return commit.endswith(DIRTY)
