"""The report of many studies: what they found in prose, and the same as Markdown, JSON and LaTeX."""

import json
import re

from softdeca.benchmarks.harness import Table
from softdeca.benchmarks.harness.page import render_template, to_markdown
from softdeca.benchmarks.studies.verification import Verification


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
    heading = Verification.question
    assert f'<h2 id="verification">{heading}</h2>' in text
    lines = (tmp_path / "report.md").read_text().splitlines()
    assert lines.index("## Is the fast simulator right?") < lines.index(f"### {heading}")
    assert json.loads((tmp_path / "report.json").read_text())["verification"]["options"]["solvers"] == ["skfem"]
    tables = (tmp_path / "tables.tex").read_text()
    assert tables.count(r"\begin{table}") == tables.count(r"\bottomrule") == 1 and r"\label{tab:verification" in tables


def test_a_table_as_markdown_and_latex():
    table = Table("50 % of |x|", ["law", "error [mm]"], [("a_b & c", 0.00012345), (True, None)], "by hand")
    assert to_markdown(table).splitlines()[2:6] == [
        "| law | error [mm] |",
        "|---|---|",
        "| a_b & c | 1.2e-04 |",
        "| yes | – |",
    ]
    text = render_template("tables.tex", sections={"laws": {"tables": [], "rows": table}})
    assert r"a\_b \& c & 1.2e-04 \\" in text and r"50 \% of |x|" in text and r"\label{tab:laws-1}" in text
