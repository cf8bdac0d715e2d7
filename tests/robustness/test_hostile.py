"""Bad arguments, options and files: each is refused in a line, or taken.

Each test's cases run in a child, so that a crash or a lack of memory there is a failure here; by hand it can try more,
and `make fuzz` tries more files.
"""

import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def count_cases(*words, folder: Path) -> dict[str, int]:
    """The counts that a program prints last, as JSON; a status that is not 0 fails the test."""
    ended = subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=900, cwd=folder)
    assert ended.returncode == 0, f"ended with {ended.returncode}\n{ended.stdout[-5000:]}\n{ended.stderr[-2000:]}"
    return json.loads(ended.stdout.splitlines()[-1])


def test_every_bad_argument_or_option_ends_in_a_line(tmp_path):
    counts = count_cases(HERE / "any_inputs.py", "--every", "12", "--drawn", "100", folder=tmp_path)
    assert counts["defects"] == 0 < counts["refused"]


def test_files_of_every_format_are_refused_in_a_line_or_read_as_finite():
    counts = count_cases("-m", "tests.fuzz", "--mutants", "6", "--seed", "0", folder=HERE.parents[1])
    # Mutants that are all refused, or all accepted, would test one way only.
    assert counts["found"] == 0 < 0.05 * counts["refused"] < counts["accepted"] < 20 * counts["refused"]
