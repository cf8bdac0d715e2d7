"""The tutorials run as they stand, each a program of its own; what they assert holds."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
NEEDS = {
    "validate": ("dolfinx",),
    "own_law": ("dolfinx",),
    "corpus": ("torch",),
}
PAGES = sorted(path.stem for path in (DOCS / "tutorials").glob("*.py") if path.read_text().startswith("# %%"))


def test_every_use_has_a_tutorial():
    assert PAGES == ["corpus", "own_head", "own_law", "own_solver", "report", "validate"]


@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_runs(page, tmp_path):
    for package in NEEDS.get(page, ()):
        pytest.importorskip(package)
    folder = shutil.copytree(DOCS / "tutorials", tmp_path / "tutorials")
    ended = subprocess.run(
        [sys.executable, f"{page}.py"],
        cwd=folder,
        env=os.environ | {"MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout
    assert sorted(path.name for path in folder.iterdir() if path.is_file()) == sorted(
        path.name for path in (DOCS / "tutorials").iterdir() if path.is_file()
    )
