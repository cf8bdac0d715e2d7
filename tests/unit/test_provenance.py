"""Every kept result says where, with what and from which commit it was measured; pages say it where one does not."""

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from softdeca.benchmarks.harness.page import CHANGED, render_study
from softdeca.benchmarks.harness.report import read_part, write_report
from softdeca.benchmarks.studies import load_study
from softdeca.lhm.base import provenance

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
FILES = sorted(RESULTS.rglob("*.json"))


def content(path):
    return json.loads(path.read_text())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_kept_result_says_where_and_with_what_it_was_measured(path):
    assert provenance.list_missing(content(path)) == [], "make it again from a clean tree"


def test_what_a_result_lacks_is_named():
    whole = content(RESULTS / "ranks.json")
    assert provenance.list_missing(whole) == []
    for key, missing in (("commit", "commit"), ("versions", "versions"), ("processor", "machine")):
        without = {name: value for name, value in whole["machine"].items() if name != key}
        assert provenance.list_missing(whole | {"machine": without}) == [missing]
    dirty = whole | {"machine": whole["machine"] | {"commit": "0123456-dirty"}}
    unknown = whole | {"machine": whole["machine"] | {"commit": "not known: no git checkout"}}
    assert provenance.list_missing(dirty) == ["clean tree"] and provenance.list_missing(unknown) == ["commit"]
    kept = whole | {"rows": [row | {"commit": "0123456-dirty"} for row in whole["rows"]]}
    assert provenance.list_missing(kept) == ["clean tree"]  # rows of a run before
    assert provenance.list_missing({"a": whole, "b": dirty}) == ["clean tree"]  # a report of two studies
    assert (
        provenance.list_missing([1])
        == provenance.list_missing({"scores": []})
        == ["machine", "commit", "versions", "options"]
    )


def test_a_changed_or_new_source_file_makes_a_tree_dirty(tmp_path, monkeypatch):
    root = tmp_path / "house"
    source = root / "benchmarks" / "harness" / "machine.py"
    source.parent.mkdir(parents=True)
    source.write_text("first = 1\n")
    (root / "README.md").write_text("words\n")
    sources = [source, *(source.parent / name for name in ("a.c", "a.cpp", "a.css", "a.js")), root / "constraints.txt"]
    for each in sources[1:]:
        each.write_text("as it was\n")
    monkeypatch.setattr(provenance, "__file__", str(source))

    def git(*words):
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *words], cwd=root, check=True)

    def commit():
        provenance.read_commit.cache_clear()
        return provenance.read_commit()

    try:
        git("init", "-q")
        git("add", ".")
        git("commit", "-qm", "first")
        clean = commit()
        assert re.fullmatch("[0-9a-f]{12}", clean)
        (root / "README.md").write_text("new words\n")
        git("commit", "-qam", "texts")
        assert commit() == clean  # the code is the same
        (root / "README.md").write_text("other words\n")  # results are kept while the next study runs
        (root / "benchmarks" / "results").mkdir()
        (root / "benchmarks" / "results" / "new.toml").write_text("")
        assert commit() == clean
        (root / "head.npz").write_text("made by a command")
        assert commit() == clean
        for name in ("study.py", "kernels.c", "kernels.cpp", "page.css", "weights.bin"):
            new = root / "benchmarks" / name
            new.write_text("new")
            assert commit() == clean + provenance.DIRTY
            new.unlink()
        for changed in sources:
            before = changed.read_text()
            changed.write_text("changed")
            assert provenance.is_dirty(commit()), changed
            changed.write_text(before)
        sources[-1].unlink()
        assert provenance.is_dirty(commit())
    finally:
        provenance.read_commit.cache_clear()


@pytest.mark.parametrize(
    ("commit", "earlier"), [("a" * 12, "b" * 12), ("a" * 12 + "-dirty", "b" * 12), ("a" * 12, "b-dirty")]
)
def test_pages_say_where_no_commit_holds_the_code(verified, tmp_path, commit, earlier):
    part = read_part(verified, load_study)
    rows = tuple(replace(row, commit=earlier) for row in part.results.rows)
    results = replace(part.results, machine={**part.results.machine, "commit": commit}, rows=rows)
    write_report([replace(part, results=results)], tmp_path, "mine")
    shown = [render_study(part.study, results, verified)]
    shown += [(tmp_path / name).read_text() for name in ("index.html", "report.md")]
    assert [CHANGED in text for text in shown] == 3 * ["dirty" in commit + earlier]
    assert f"{commit}, {earlier}" in shown[0] and f"{commit}, {earlier}" in shown[1]
