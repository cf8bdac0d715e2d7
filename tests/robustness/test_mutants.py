"""Every reader against damaged files: a line that names the file, or what is finite and in range."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("script", "formats", "mutants"), [("file_mutants.py", 26, 100), ("corpus_mutants.py", 14, 60)]
)
def test_damaged_files_of_every_format_are_refused_in_a_line_or_read_as_finite(script, formats, mutants):
    """In a child, so that a crash or a lack of memory there is a failure here; `mutants` of each of the formats.

    Heads, meshes and templates take 8 s of work, takes, corpora and weights 10 s. By hand the scripts read more.
    """
    ended = subprocess.run(
        [sys.executable, Path(__file__).with_name(script), str(mutants), "0"],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    last = ended.stdout.splitlines()[-1] if ended.stdout else "nothing was read"
    defects = [line for line in ended.stdout.splitlines() if line.startswith("DEFECT")]
    assert ended.returncode == 0, f"ended with {ended.returncode} at {last!r}; {defects}; {ended.stderr[-600:]}"
    counts = json.loads(last)
    assert counts["defects"] == 0 and counts["refused"] + counts["accepted"] == counts["mutants"] >= formats * mutants
    # Mutants that are all refused, or all accepted, would test one way only.
    assert min(counts["refused"], counts["accepted"]) > 0.05 * counts["mutants"]
