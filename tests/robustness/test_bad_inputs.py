"""Thousands of bad inputs: each is refused in words, or taken for a reason that is told.

Each script runs in a child, so that a crash or a lack of memory there is a failure here; by hand it can try more.
"""

import ast
import subprocess
import sys
from pathlib import Path


def run_script(script: str, folder: Path) -> dict[str, int]:
    """The counts that a script of this folder prints last, run in another folder; its defects fail the test."""
    path = Path(__file__).with_name(script)
    ended = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=900, cwd=folder, check=False)
    assert ended.returncode == 0, f"ended with {ended.returncode}\n{ended.stdout}\n{ended.stderr[-2000:]}"
    counts = ast.literal_eval(ended.stdout.splitlines()[-1])
    assert counts["defects"] == 0
    return counts


def test_every_bad_input_is_refused_in_words(tmp_path):
    assert run_script("bad_inputs.py", tmp_path)["refused"] > 3300


def test_nothing_that_hypothesis_draws_is_a_defect(tmp_path):
    assert run_script("any_inputs.py", tmp_path)["of each"] > 100
