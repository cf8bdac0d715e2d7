"""The main study: which studies it has, and that one which cannot be run leaves the rest complete."""

import json

from softdeca.benchmarks import main_study
from softdeca.benchmarks.harness import RunRequest
from softdeca.benchmarks.main_study import choose_studies
from softdeca.benchmarks.studies.agreement.material import Material
from softdeca.benchmarks.studies.agreement.study import Agreement
from softdeca.benchmarks.studies.surrogate.study import SurrogateOnCorpus
from softdeca.benchmarks.studies.verification import Verification


def names(agreement, corpus):
    return [part.study.name for part in choose_studies(agreement, corpus.parent, corpus)]


def test_every_part_has_something_to_do(tmp_path):
    found = choose_studies(Agreement(), tmp_path, tmp_path / "corpus")
    for part in found:
        if not isinstance(part.study, SurrogateOnCorpus):
            assert any(part.match.lower() in str(task).lower() for task in part.study.tasks()), part
    # What is timed comes after what is not: nothing of ours runs beside it.
    timed = [part.study.timed for part in found]
    assert timed == sorted(timed) and found[0].study.name == "agreement" and found[-1].study.name == "work-precision"


def test_people_that_no_network_knows_have_no_surrogate(tmp_path, monkeypatch):
    monkeypatch.setattr(Agreement, "network", lambda self: None)
    assert not {"surrogate", "split"} & set(names(Agreement(), tmp_path))
    last = choose_studies(Agreement(), tmp_path, tmp_path)[-1]
    tasks = [str(task) for task in last.study.tasks() if last.match.lower() in str(task).lower()]
    assert tasks and not any("ARAP" in task for task in tasks)


def test_a_study_that_cannot_be_run_is_told_and_the_rest_is_complete(tmp_path, monkeypatch, command):
    good = RunRequest(Verification(solvers=("skfem",)), tmp_path / "verification", "two layers")
    monkeypatch.setattr(
        main_study,
        "choose_studies",
        lambda *given, **options: [RunRequest(Material(modes=("torsion",)), tmp_path / "material"), good],
    )
    ended = command("study", "--out", tmp_path)
    assert ended.status == 1 and any(
        "FAILED material: unknown mode 'torsion'" in line for line in ended.out.splitlines()
    )
    for name in ("index.html", "report.md"):
        text = (tmp_path / name).read_text()
        assert "study material could not be run" in text and "4 of 4 values by skfem" in text
    rows = (tmp_path / "verification" / "rows.jsonl").read_text()
    monkeypatch.setattr(main_study, "choose_studies", lambda *given, **options: [good])
    again = command("study", "--out", tmp_path, "--json")
    assert again.status == 0 and list(json.loads(again.out)) == ["verification"]
    assert (tmp_path / "verification" / "rows.jsonl").read_text() == rows
