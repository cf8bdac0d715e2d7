"""Bad arguments, options and files: each is refused in words, or taken for a reason that is told.

Each test's cases run in a child, so that a crash or a lack of memory there is a failure here; by hand it can try more,
and `make fuzz` tries files for an hour.
"""

import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
EVERY, DRAWN, MUTANTS = 4, 150, 20
"""Of listed cases one in so many; draws of each property; mutants of each format."""


def count_cases(*words, folder: Path) -> dict[str, int]:
    """The counts that a program prints last, as JSON; a status that is not 0 fails the test."""
    ended = subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=900, cwd=folder)
    assert ended.returncode == 0, f"ended with {ended.returncode}\n{ended.stdout[-5000:]}\n{ended.stderr[-2000:]}"
    return json.loads(ended.stdout.splitlines()[-1])


def test_every_bad_argument_or_option_is_refused_in_words(tmp_path):
    counts = count_cases(HERE / "any_inputs.py", "--every", str(EVERY), "--drawn", str(DRAWN), folder=tmp_path)
    refused = counts["refused"] + counts["refused plainly"]
    assert refused > 3300 / EVERY and counts["drawn"] == 3 * DRAWN and counts["defects"] == 0


def test_files_of_every_format_are_refused_in_a_line_or_read_as_finite():
    counts = count_cases("-m", "tests.fuzz", "--mutants", str(MUTANTS), "--seed", "0", folder=HERE.parents[1])
    tried = counts["refused"] + counts["accepted"]
    assert counts["found"] == 0 and tried > counts["formats"] * MUTANTS
    # Mutants that are all refused, or all accepted, would test one way only.
    assert min(counts["refused"], counts["accepted"]) > 0.05 * tried
