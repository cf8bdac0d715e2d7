"""Every measured figure of README and docs is what benchmarks/results say; every picture is of today's program."""

import importlib.util
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def tool(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


pytest.importorskip("tomllib")  # from Python 3.11 on
figures, pictures = tool("figures"), tool("pictures")
FIGURES, SETTINGS, EXCLUDED = figures.read_map()
PAGES = figures.list_pages(EXCLUDED)


@pytest.mark.parametrize("page", PAGES)
def test_no_figure_without_a_result(page):
    text = (ROOT / page).read_text()
    here = [figure for figure in FIGURES if figure.page == page]
    assert figures.find_wrong(text, here) == [], "run `python tools/figures.py --update`"
    assert figures.find_unknown(page, text, here, SETTINGS.get(page, [])) == []


def test_every_figure_is_on_a_page_that_is_read():
    assert {figure.page for figure in FIGURES} | set(SETTINGS) <= set(PAGES)
    assert "README.md" in PAGES and len([figure for figure in FIGURES if figure.page == "README.md"]) >= 7


def test_a_changed_figure_a_new_one_and_an_unused_setting_are_named():
    page = "docs/corpus.md"
    text, here = (ROOT / page).read_text(), [figure for figure in FIGURES if figure.page == page]
    (figure,) = (figure for figure in here if "simulates takes {:.0f} MB" in figure.text)
    match = figures.find_place(text, figure)
    changed = text[: match.start(1)] + "417,000" + text[match.end(1) :]
    (told,) = figures.find_wrong(changed, here)
    assert told.startswith(f"docs/corpus.md: 417,000 should be {match[1]} in ")
    assert figures.update_text(changed, here) == text
    more = text + "\nIt is 3.7 mm off,\ntakes two minutes and .5 s.\n\n| a | 17 |\n|---|---|\n"
    told = figures.find_unknown(page, more, here, SETTINGS[page])
    assert len(told) == 4 and all("no figure with a result" in line for line in told)
    assert [number in line for number, line in zip(("3.7", "two", ".5", "17"), told, strict=True)] == 4 * [True]
    (told,) = figures.find_unknown(page, text, here, [*SETTINGS[page], "never said"])
    assert "no place for the setting 'never said'" in told


def test_a_figure_follows_its_results(tmp_path, monkeypatch):
    shutil.copytree(figures.RESULTS, tmp_path / "results")
    monkeypatch.setattr(figures, "RESULTS", tmp_path / "results")
    path = tmp_path / "results" / "agreement.json"
    content = json.loads(path.read_text())
    for row in content["rows"]:
        if row["values"].get("another_minimum_mm"):
            row["values"]["another_minimum_mm"] = 0.987
    path.write_text(json.dumps(content))
    (figure,) = (each for each in FIGURES if "two minima" in each.text)
    figures.lines.cache_clear()
    try:
        assert figure.numbers() == ["0.99"]
        assert figures.as_written("0.99", ".23") == ".99" and figures.as_written("0.99", "0.23") == "0.99"
        with pytest.raises(SystemExit, match="agreement.json: no line with another_minimum_mm"):
            replace(figure, values=(figure.values[0].replace("mouthSmile*", "none"),)).numbers()
    finally:
        figures.lines.cache_clear()


def test_a_missed_gate_is_told_beside_its_figure():
    missed = [figure for figure in FIGURES if figure.misses]
    assert all("missed" in figure.text for figure in missed)
    (kept,) = (figure for figure in FIGURES if "linear solves and {:.1f} GB" in figure.text)
    assert not kept.misses  # its memory has a gate
    text = re.sub(r"and (\d\.\d GB)", r"and missed \1", (ROOT / kept.page).read_text())
    figure = replace(kept, text=kept.text.replace("and {:.1f}", "and missed {:.1f}"))
    (told,) = figures.find_wrong(text, [figure])
    assert "keeps its gate: say so" in told


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
