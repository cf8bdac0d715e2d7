"""Every reader of takes, options, corpora, weights and results against damaged files: see `corpus_mutants.py`."""

import json
import subprocess
import sys
from pathlib import Path

MUTANTS = 60
"""Of each format: 840 in all, and 10 s of work. `corpus_mutants.py` reads more by hand."""


def test_damaged_files_of_every_format_are_refused_in_a_line_or_read_as_finite():
    """In a child, so that a crash or a lack of memory there is a failure here."""
    script = Path(__file__).with_name("corpus_mutants.py")
    ended = subprocess.run(
        [sys.executable, script, str(MUTANTS), "0"], capture_output=True, text=True, timeout=600, check=False
    )
    last = ended.stdout.splitlines()[-1] if ended.stdout else "nothing was read"
    defects = [line for line in ended.stdout.splitlines() if line.startswith("DEFECT")]
    assert ended.returncode == 0, f"ended with {ended.returncode} at {last!r}; {defects}; {ended.stderr[-600:]}"
    counts = json.loads(last)
    assert counts["defects"] == 0 and counts["refused"] + counts["accepted"] == counts["mutants"] >= 14 * MUTANTS
    # Mutants that are all refused, or all accepted, would test one way only.
    assert min(counts["refused"], counts["accepted"]) > 0.05 * counts["mutants"]
