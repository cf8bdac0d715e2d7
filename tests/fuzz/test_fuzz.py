"""Kept inputs and mutants of every format that may come from a stranger, the same each time; `make fuzz` tries more."""

import json
import subprocess
import sys
from pathlib import Path

MUTANTS = 60
"""Of each format: together a minute."""


def test_files_of_every_format_are_refused_in_a_line_or_read_as_finite():
    # In a process of its own, so that a crash or a lack of memory there is a failure here.
    ended = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", "--mutants", str(MUTANTS), "--seed", "0"],
        cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip
    lines = ended.stdout.splitlines() or ["nothing was read"]
    found = [line for line in lines if line.startswith("FOUND")]
    assert ended.returncode == 0, "\n".join(
        [f"ended with {ended.returncode}, {lines[-1]}", *found, ended.stderr[-2000:]]
    )
    counts = json.loads(lines[-1])
    tried = counts["refused"] + counts["accepted"]
    assert counts["found"] == 0 and tried > counts["formats"] * MUTANTS
    # Mutants that are all refused, or all accepted, would test one way only.
    assert min(counts["refused"], counts["accepted"]) > 0.05 * tried
