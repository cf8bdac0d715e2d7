"""The pages of the documentation that are programs run as they stand; what they assert holds."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
NEEDS = {
    "concepts": ("dolfinx",),
    "tutorials/validate": ("dolfinx",),
    "tutorials/own_law": ("dolfinx",),
    "tutorials/corpus": ("torch",),
}
PAGES = sorted(
    str(path.relative_to(DOCS).with_suffix("")) for path in DOCS.rglob("*.py") if path.read_text().startswith("# %%")
)


def test_every_use_has_a_tutorial():
    uses = {"corpus", "own_head", "own_law", "own_solver", "report", "validate", "whole_idea"}
    assert set(PAGES) == {"concepts", *(f"tutorials/{use}" for use in uses)}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs(page, tmp_path):
    for package in NEEDS.get(page, ()):
        pytest.importorskip(package)
    docs = shutil.copytree(DOCS, tmp_path / "docs")
    file = docs / f"{page}.py"
    before = sorted(docs.rglob("*"))
    ended = subprocess.run(
        [sys.executable, file.name],
        cwd=file.parent,
        env=os.environ | {"MPLBACKEND": "Agg", "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout
    # What a page writes is elsewhere.
    assert sorted(docs.rglob("*")) == before
