"""Thousands of bad inputs, by hand and by hypothesis: each is refused in words, or taken for a reason that is told."""

import ast
import subprocess
import sys
from pathlib import Path


def run_beside(script: str, folder: Path) -> dict[str, int]:
    """The counts that a script of this folder prints last, run in another folder; its defects fail the test."""
    path = Path(__file__).with_name(script)
    ended = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=900, cwd=folder)
    told = ended.stdout.splitlines()
    assert ended.returncode == 0, "\n".join([*told[-20:], ended.stderr[-2000:]])
    return ast.literal_eval(told[-1])


def test_every_bad_input_is_refused_in_words(tmp_path):
    counts = run_beside("bad_inputs.py", tmp_path)
    assert counts["defects"] == 0 and counts["refused"] > 3300


def test_nothing_that_hypothesis_draws_is_a_defect(tmp_path):
    counts = run_beside("any_inputs.py", tmp_path)
    assert counts["defects"] == 0 and counts["of each"] > 100
