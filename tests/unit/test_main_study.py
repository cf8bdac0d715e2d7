"""The main study: which studies it has, and that one which cannot be run leaves the rest complete."""

import json

from softdeca.benchmarks import main_study
from softdeca.benchmarks.harness import RunRequest
from softdeca.benchmarks.studies.faces import Faces
from softdeca.benchmarks.studies.verification import Verification


def test_a_study_that_cannot_be_run_is_told_and_the_rest_is_complete(tmp_path, monkeypatch, command):
    good = RunRequest(Verification(solvers=("skfem",)), tmp_path / "verification", "two layers")
    monkeypatch.setattr(
        main_study,
        "choose_studies",
        lambda *given, **options: [RunRequest(Faces(people=0), tmp_path / "faces"), good],
    )
    ended = command("study", "--out", tmp_path)
    assert ended.status == 1 and any(
        "FAILED faces: people, frames, expressions: expected 1" in line for line in ended.out.splitlines()
    )
    for name in ("index.html", "report.md"):
        text = (tmp_path / name).read_text()
        assert "study faces could not be run" in text and "4 of 4 values by skfem" in text
    rows = (tmp_path / "verification" / "rows.jsonl").read_text()
    monkeypatch.setattr(main_study, "choose_studies", lambda *given, **options: [good])
    again = command("study", "--out", tmp_path, "--json")
    assert again.status == 0 and list(json.loads(again.out)) == ["verification"]
    assert (tmp_path / "verification" / "rows.jsonl").read_text() == rows
