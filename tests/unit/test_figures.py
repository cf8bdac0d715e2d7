"""Pages tell what benchmarks/results say, or cannot be built; every picture is of today's program."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


results, pictures = load(ROOT / "docs" / "results.py"), load(ROOT / "tools" / "pictures.py")
PAGES = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_filled_from_the_results(page):
    filled = results.fill((ROOT / page).read_text(), page)
    assert "{{ " not in filled and "nan" not in re.findall(r"\| (nan) \|", filled)


def test_readme_is_its_template_filled():
    text = results.fill(results.README_TEMPLATE.read_text(), "docs/readme.in")
    assert results.README.read_text() == text, "run `python docs/results.py`"
