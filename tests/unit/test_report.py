"""The report of many studies: what they found in prose, and the same as Markdown, JSON and LaTeX."""

import json
import re

import pytest

from softdeca.benchmarks.harness import Table
from softdeca.benchmarks.harness.page import to_latex, to_markdown
from softdeca.benchmarks.harness.report import read_part, write_report
from softdeca.benchmarks.studies import load_study
from softdeca.benchmarks.studies.verification import Verification
from softdeca.lhm import InputError


def test_a_report_of_studies_says_what_they_found(verified, command, tmp_path):
    ended = command("bench", "report", verified, "--out", tmp_path)
    assert ended.status == 0 and len(ended.out.splitlines()) == 4
    text = (tmp_path / "index.html").read_text()
    assert (
        "the fast simulator, finite elements and the network" in text
        and "4 of 4 values by skfem are within their bounds." in text
    )
    assert "Is the fast simulator right?" in text and "Every statement holds within its bound." in text
    text = text.replace('<link rel="icon" href="data:,">', "")
    assert not re.search(r"<(script|link|iframe|object)|@import|(src|href)=\"(?!#|data:)", text)
    heading = Verification.heading
    assert f'<h2 id="verification">{heading}</h2>' in text
    lines = (tmp_path / "report.md").read_text().splitlines()
    assert lines.index("## Is the fast simulator right?") < lines.index(f"### {heading}")
    assert json.loads((tmp_path / "report.json").read_text())["verification"]["options"]["solvers"] == ["skfem"]
    tables = (tmp_path / "tables.tex").read_text()
    assert tables.count(r"\begin{table}") == tables.count(r"\bottomrule") == 1 and r"\label{tab:verification" in tables


def test_results_that_are_none_are_named(verified, command, tmp_path):
    (tmp_path / "results.json").write_text("{}")
    with pytest.raises(InputError, match="results.json: no results of a study"):
        read_part(tmp_path, load_study)
    once = read_part(verified, load_study)
    with pytest.raises(InputError, match="each study once"):
        write_report([once, once], tmp_path, "twice")
    found = json.loads((verified / "results.json").read_text())
    del found["rows"][0]["values"]["outcomes"]
    (tmp_path / "results.json").write_text(json.dumps(found))
    ended = command("bench", "report", tmp_path, "--out", tmp_path / "out")
    assert ended.status == 1 and "another version" in ended.errors[0] and not (tmp_path / "out").exists()


def test_a_table_as_markdown_and_latex():
    table = Table("50 % of |x|", ["law", "error [mm]"], [("a_b & c", 0.00012345), (True, None)], "by hand")
    assert to_markdown(table).splitlines()[2:6] == [
        "| law | error [mm] |",
        "|---|---|",
        "| a_b & c | 1.2e-04 |",
        "| yes | – |",
    ]
    text = to_latex(table, "laws, by hand")
    assert r"a\_b \& c & 1.2e-04 \\" in text and r"50 \% of |x|" in text and r"\label{tab:laws-by-hand}" in text
