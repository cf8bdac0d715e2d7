"""The pictures of README and docs are those that today's code draws."""

import importlib.util
import re
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]


def tool():
    spec = importlib.util.spec_from_file_location("docs_pictures", ROOT / "tools" / "docs_pictures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["jaw-open", "weight", "own-head", "viewer"])
def test_a_picture_is_not_older_than_what_draws_it(name):
    drawn = tool()
    image, sources = Image.open(ROOT / "docs" / f"{name}.png"), drawn.PICTURES[name][1]
    remedy = f"docs/{name}.png is older than {', '.join(sources)}: run tools/docs_pictures.py {name}"
    assert image.info[drawn.DREW] == drawn.digest(sources), remedy
    assert image.width >= 800 and (ROOT / "docs" / f"{name}.png").stat().st_size < 400_000


def test_a_change_of_a_source_makes_a_picture_old(tmp_path, monkeypatch):
    drawn = tool()
    (tmp_path / "a.py").write_text("1")
    monkeypatch.setattr(drawn, "ROOT", tmp_path)
    before = drawn.digest(("a.py",))
    (tmp_path / "a.py").write_text("2")
    assert drawn.digest(("a.py",)) != before


def test_every_picture_of_readme_and_docs_is_there():
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("*.py")]
    named = {
        (page.parent / path).resolve()
        for page in pages
        for path in re.findall(r"!\[[^\]]*\]\(([^)]+\.png)\)", page.read_text())
    }
    assert len(named) > 4 and all(path.is_file() for path in named)
