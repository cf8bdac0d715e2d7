"""Thousands of bad inputs and damaged files: each is refused in words, or taken for a reason that is told.

Each script runs in a child, so that a crash or a lack of memory there is a failure here; by hand it can try more.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest


def run_script(script: str, folder: Path, *arguments: str) -> dict[str, int]:
    """The counts that a script of this folder prints last, run in another folder; its defects fail the test."""
    path = Path(__file__).with_name(script)
    ended = subprocess.run(
        [sys.executable, path, *arguments], capture_output=True, text=True, timeout=900, cwd=folder, check=False
    )
    lines = [line for line in ended.stdout.splitlines() if not line.startswith("at ")]
    place = (ended.stdout.splitlines() or ["nothing was read"])[-1]
    assert ended.returncode == 0, "\n".join([f"ended with {ended.returncode} at {place}", *lines, ended.stderr[-2000:]])
    counts = ast.literal_eval(lines[-1])
    assert counts["defects"] == 0
    return counts


def test_every_bad_input_is_refused_in_words(tmp_path):
    assert run_script("bad_inputs.py", tmp_path)["refused"] > 3300


def test_nothing_that_hypothesis_draws_is_a_defect(tmp_path):
    assert run_script("any_inputs.py", tmp_path)["of each"] > 100


@pytest.mark.parametrize(
    ("script", "formats", "mutants"), [("file_mutants.py", 26, 100), ("corpus_mutants.py", 14, 60)]
)
def test_damaged_files_of_every_format_are_refused_in_a_line_or_read_as_finite(tmp_path, script, formats, mutants):
    counts = run_script(script, tmp_path, str(mutants), "0")
    assert counts["refused"] + counts["accepted"] == counts["mutants"] >= formats * mutants
    # Mutants that are all refused, or all accepted, would test one way only.
    assert min(counts["refused"], counts["accepted"]) > 0.05 * counts["mutants"]
