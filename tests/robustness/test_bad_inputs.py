"""Thousands of bad inputs by `bad_inputs.py`: each is refused in words, or accepted for a reason that is told."""

import subprocess
import sys
from pathlib import Path


def test_every_bad_input_is_refused_in_words(tmp_path):
    script = Path(__file__).with_name("bad_inputs.py")
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=900, cwd=tmp_path)
    told = ended.stdout.splitlines()
    assert ended.returncode == 0 and told[-1].endswith("'defects': 0}"), "\n".join([*told[-20:], ended.stderr[-2000:]])
    assert int(told[-1].split(":")[1].split(",")[0]) > 3000
