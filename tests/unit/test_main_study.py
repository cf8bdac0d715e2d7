"""The main study: which studies it has, and that one which cannot be run leaves the rest complete."""

import json

import pytest

from softdeca.benchmarks import study
from softdeca.benchmarks.studies.agreement import Agreement
from softdeca.benchmarks.studies.material import Material
from softdeca.benchmarks.studies.surrogate import SurrogateOnCorpus
from softdeca.benchmarks.studies.verification import Verification
from softdeca.benchmarks.study import Part, parts


def names(agreement, corpus):
    return [part.study.name for part in parts(agreement, corpus)]


def test_every_part_has_something_to_do(tmp_path):
    found = parts(Agreement(), tmp_path)
    for part in found:
        if not isinstance(part.study, SurrogateOnCorpus):
            assert any(part.match.lower() in str(task).lower() for task in part.study.tasks()), part
    # What is timed comes after what is not: nothing of ours runs beside it.
    assert names(Agreement(), tmp_path)[0] == "agreement" and names(Agreement(), tmp_path)[-1] == "work-precision"


def test_people_that_no_network_knows_have_no_surrogate(tmp_path, monkeypatch):
    monkeypatch.setattr(Agreement, "network", lambda self: None)
    assert not {"surrogate", "split"} & set(names(Agreement(), tmp_path))
    assert not any("learned" in str(task) for task in parts(Agreement(), tmp_path)[-1].study.tasks()
                   if parts(Agreement(), tmp_path)[-1].match.lower() in str(task).lower())  # fmt: skip


def test_a_study_that_cannot_be_run_is_told_and_the_rest_is_complete(tmp_path, monkeypatch, command):
    good = Part(Verification(solvers=("skfem",)), "two layers")
    monkeypatch.setattr(study, "parts", lambda agreement, corpus: [Part(Material(modes=("torsion",))), good])
    ended = command("study", "--out", tmp_path)
    assert ended.status == 1 and any("FAILED material: mode 'torsion'" in line for line in ended.out.splitlines())
    for name in ("index.html", "report.md"):
        text = (tmp_path / name).read_text()
        assert "study material could not be run" in text and "4 of 4 values by skfem" in text
    rows = (tmp_path / "verification" / "rows.jsonl").read_text()
    monkeypatch.setattr(study, "parts", lambda agreement, corpus: [good])
    again = command("study", "--out", tmp_path, "--json")
    assert again.status == 0 and list(json.loads(again.out)) == ["verification"]
    assert (tmp_path / "verification" / "rows.jsonl").read_text() == rows


def test_an_expression_that_there_is_not_ends_it_before_anything_is_run(tmp_path, command):
    ended = command("study", "--expressions", "jawOpenn", "--out", tmp_path / "out")
    assert ended.status == 1 and "jawOpenn" in ended.errors[0] and not (tmp_path / "out").exists()


@pytest.mark.parametrize("people", ["test", "all"])
def test_the_surrogate_needs_a_corpus_that_is_there(tmp_path, people):
    with pytest.raises(study.SoftdecaError, match="corpus|manifest"):
        SurrogateOnCorpus(corpus=str(tmp_path), people=people).tasks()
