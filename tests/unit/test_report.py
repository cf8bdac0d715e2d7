"""The report of many studies: what they found in prose, and the same as Markdown, JSON and LaTeX."""

import json
import re
from pathlib import Path

import pytest

from softdeca.benchmarks.harness import Table
from softdeca.benchmarks.harness.page import to_latex, to_markdown
from softdeca.benchmarks.harness.report import read_part, write_report
from softdeca.benchmarks.harness.study import at_least
from softdeca.benchmarks.studies import load_study
from softdeca.benchmarks.studies.verification import Verification
from softdeca.lhm import InputError

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


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


def test_a_report_says_what_it_cost_and_whether_the_tree_was_clean(verified, tmp_path):
    file = tmp_path / "results.json"
    found = json.loads((verified / "results.json").read_text())
    rows = found["rows"]
    # Another process measured each row: its processor time is at most what one thread can spend, and some margin.
    assert all(0.0 < row["cpu"] < row["seconds"] + 0.5 for row in rows)
    for row in rows:
        row["cpu"] = 2.5
    for commit, clean in (("abc1234", "<span class=yes>yes</span>"), ("abc1234-dirty", "<span class=no>NO</span>")):
        found["machine"] |= {"commit": commit, "load": 0.25}
        for row in rows:
            row["commit"] = commit
        file.write_text(json.dumps(found))
        text = write_report([read_part(file, load_study)], tmp_path / "out", "cost", spent="This run took no time.")[
            0
        ].read_text()
        (line,) = re.findall(rf"<tr><td class=text>Do the solvers give.*{commit}<.*</tr>", text)
        assert clean in line and ">0.25<" in line and ">10<" in line
        assert "4 of 4 rows took 10 s of processor time together. This run took no time." in text
    # Results of before rows had a processor time can still be reported.
    for row in rows:
        del row["cpu"]
    file.write_text(json.dumps(found))
    assert (
        "of processor time together"
        not in write_report([read_part(file, load_study)], tmp_path / "o", "old")[0].read_text()
    )


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


def test_a_missed_bound_is_a_line_with_its_numbers(verified, tmp_path):
    found = json.loads((verified / "results.json").read_text())
    found["gates"] = [at_least("share of answers", 0.917, 0.95, answer=False) | {"count": 24}]
    (tmp_path / "results.json").write_text(json.dumps(found))
    text = write_report([read_part(tmp_path, load_study)], tmp_path / "out", "missed")[0].read_text()
    assert "<li>share of answers (24 values): <b class=no>0.917</b>, at least 0.95 <" in text
    # Rows share solves where nothing is timed: what one row waited is no method's cost.
    assert "all of it [s]" not in text and "processor time [s]</th>" in text.partition("Where and with what")[2]


def test_no_panel_stands_empty():
    part = read_part(RESULTS / "work-precision.json", load_study)
    for energies, panels in ((("Eq. 15",), 2), (("Eq. 15", "ARAP"), 3), ((), 0)):
        rows = [row for row in part.results.rows if any(energy in row.values["law"] for energy in energies)]
        drawn = "".join(part.study.pictures(rows).values())
        assert len(re.findall(r'id="axes_\d+"', drawn)) == panels


def test_the_dial_says_how_much_its_answers_decide():
    part = read_part(RESULTS / "dial.json", load_study)
    rows = [row for row in part.results.rows if row.case.endswith("person 0")]
    assert "of 12 people. It is within" in part.study.words(part.results.rows)
    words, count = part.study.words(rows), sum(len(row.values["told"]) for row in rows)
    assert f"{count} answers" in words and "too few to judge a share of 95 %, which takes 200" in words
    assert [gate.get("count") for gate in part.study.gates(rows)][0] == count
    # Accuracies that cost the same are named together, and where projective dynamics alone is cheaper that is said.
    for row in rows:
        for told in row.values["told"]:
            told["ms"] = {0.1: 80.0, 0.05: 82.0, 0.02: 78.0, 0.01: 100.0}.get(told["accuracy"], 150.0)
    assert "0.1, 0.05, 0.02 mm in 80 ms; 0.01 mm in 100 ms; 0.003, 0.001 mm in 150 ms" in part.study.words(rows)
    for row in rows:
        row.values["lean"].append({"method": "PD, from first order", "true": 1e-5, "ms": 0.01})
    rows[0].values["lean"] += rows[0].values["lean"][-1:] * 1000
    assert "PD, from first order is cheaper than the dial at 0.1, 0.05" in part.study.words(rows)


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
