"""Pages tell what benchmarks/results say, or cannot be built; every picture is of today's program."""

import importlib.util
import json
import re
import shutil
import sys
from pathlib import Path

import pytest

from softdeca.benchmarks.kept import State
from softdeca.surrogate.methods import METHODS

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


def test_most_figures_of_the_pages_are_from_results():
    templates = [results.README_TEMPLATE, *(ROOT / page for page in PAGES)]
    assert sum(len(results.BRACES.findall(path.read_text())) for path in templates) > 300


def test_methods_on_pages_have_the_labels_of_the_house():
    assert set(results.READY) <= set(METHODS)


@pytest.mark.parametrize(
    ("expression", "words"),
    [
        ('one("none", "share")', "none.json: no such file in benchmarks/results"),
        ('one("split", "shares", case="defaults")', "split.json: no line with shares"),
        ('every("split", "share", case="nobody")', "split.json: no line with share of {'case': 'nobody'}"),
        ('one("split", "share")', "split.json: [0-9]+ lines with share of {}, expected one"),
        ('share("netwrok")', "surrogate/fresh.json: 0 scores of 'netwrok' on 'all', expected one"),
        ('gate("split", "none of them")', "split.json: 0 gates 'none of them', expected one"),
        ('of("split", "gates.99")', "split.json: no gates.99"),
        ("open('x')", "name 'open' is not defined"),
        ('share("network") : .1q', "Unknown format code|Invalid format specifier"),
    ],
)
def test_what_no_result_has_is_named_with_its_page(expression, words):
    with pytest.raises(results.MissingResultError, match=words) as error:
        results.fill(f"It leaves {{{{ {expression} }}}} %.", "docs/page.md")
    assert str(error.value).startswith(f"docs/page.md: {{{{ {expression} }}}}: ") and "\n" not in str(error.value)


def test_a_figure_follows_its_results(tmp_path, monkeypatch):
    shutil.copytree(results.RESULTS, tmp_path / "results")
    monkeypatch.setattr(results, "RESULTS", tmp_path / "results")
    path = tmp_path / "results" / "agreement.json"
    content = json.loads(path.read_text())
    for gate in content["gates"]:
        gate |= {"value": 0.987, "passed": False}
    path.write_text(json.dumps(content))
    results._read_once.cache_clear()
    try:
        asked = ['gate("agreement", "smallest*") : .2f', 'gate("agreement", "smallest*") : ~.2f']
        asked.append('verdict("agreement", "smallest*")')
        page = " ".join(f"{{{{ {expression} }}}}" for expression in asked)
        assert results.fill(page, "docs/page.md") == "0.99 .99 missed"
    finally:
        results._read_once.cache_clear()


def test_a_page_says_which_of_its_results_are_stale(monkeypatch):
    found = {"split": State("split", ("heads", "network")), "mesh": State("mesh"), "hard": State("hard", single="old")}
    monkeypatch.setattr(results, "judge", found.__getitem__)
    page = '# Title\n\n{{ of("%s", "study") }}\n'
    noted = results.fill_page(page % "split", "docs/page.md")
    assert noted.startswith("# Title\n\n:::{note}\n") and "- `split` is stale: heads, network.\n:::\n" in noted
    assert results.fill_page(page % "mesh", "docs/page.md") == "# Title\n\nmesh\n"
    assert "- `hard` stays with its commit: old." in results.fill_page(page % "hard", "docs/page.md")


DRAWN_ELSEWHERE = {"surrogate-cost.png", "surrogate-frames.png"}
"""Pictures of the model card: `softdeca evaluate` draws them, from a corpus."""


def test_pictures_are_of_todays_program():
    assert pictures.find_stale() == {}, "run `python tools/pictures.py` and look at what it draws"
    shown = set()
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").rglob("*.py")]:
        shown |= {Path(name).name for name in re.findall(r"!\[[^\]]*\]\(([^)]+\.png)\)", page.read_text())}
    assert shown == set(pictures.PICTURES) | DRAWN_ELSEWHERE
    assert {path.name for path in (ROOT / "docs").glob("*.png")} == shown


def test_a_picture_is_old_where_what_it_is_drawn_from_changed(tmp_path, monkeypatch):
    (tmp_path / "docs").mkdir()
    for name in pictures.PICTURES:
        shutil.copy(pictures.DOCS / name, tmp_path / "docs")
    monkeypatch.setattr(pictures, "DOCS", tmp_path / "docs")
    (tmp_path / "docs" / "weight.png").write_bytes(b"another")
    assert pictures.find_stale() == {"weight.png": "not the file that was drawn"}
    (tmp_path / "docs" / "weight.png").unlink()
    for source in {source for _, sources in pictures.PICTURES.values() for source in sources}:
        (tmp_path / source).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / source, tmp_path / source)
    monkeypatch.setattr(pictures, "ROOT", tmp_path)
    assert set(pictures.find_stale()) == {"weight.png"}
    with (tmp_path / "animation" / "app.js").open("a") as file:
        file.write("// changed")
    assert set(pictures.find_stale()) == {"weight.png", "viewer.png"}
