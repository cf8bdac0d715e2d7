"""softdeca study: the main job from its first command to the report, on the coarsest head and few cases."""

import json
import subprocess
import sys

import pytest

from softdeca.benchmarks.harness import runner

pytest.importorskip("dolfinx")

pytestmark = pytest.mark.timeout(900)

STUDIES = ["faces", "hard", "verification"]


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    """The ended command and its folder. A minute of processor."""
    out = tmp_path_factory.mktemp("study")
    words = [sys.executable, "-c", "from softdeca.cli import main; main()", "study", "--small", "--out", out]
    return subprocess.run(words, capture_output=True, text=True), out


def test_the_study_ends_with_a_report_of_every_part(studied):
    ended, out = studied
    assert ended.returncode == 0 and "FAILED" not in ended.stdout and f"wrote {out / 'index.html'}" in ended.stdout, (
        ended.stderr
    )
    report = json.loads((out / "report.json").read_text())
    assert sorted(report) == STUDIES
    for name, results in report.items():
        done = [row for row in results["rows"] if row["status"] == "done"]
        assert done and not [row for row in results["rows"] if row["status"] == "failed"], name
        missed = [gate["what"] for gate in results["gates"] if gate["answer"] and not gate["passed"]]
        assert not missed, (name, missed)


def test_the_first_screen_tells_the_simulator_methods_and_costs_in_this_order(studied):
    _, out = studied
    page = (out / "index.html").read_text()
    told = ("PD is the fast simulator", "The simulator misses converged finite elements by", "Each method misses its",
            "For many frames of a face pick", " kinds of p")  # fmt: skip
    places = [page.index(words) for words in told]
    assert places == sorted(places) and "<svg" in page and "Error to converged finite elements, and cost" in page


def test_a_second_run_measures_nothing_again(studied, command, monkeypatch):
    _, out = studied
    before = {path: path.read_bytes() for path in out.glob("*/rows.jsonl")}
    assert len(before) == len(STUDIES)
    asked = []
    monkeypatch.setattr(runner, "measure_jobs", lambda jobs, lanes: asked.extend(jobs) or iter(()))
    assert command("study", "--small", "--out", out).status == 0 and asked == []
    assert {path: path.read_bytes() for path in before} == before
