"""Kept results: each can be made again by name, says what decided it, and is stale or moved where that is changed."""

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from softdeca.benchmarks import kept
from softdeca.benchmarks.harness import inputs
from softdeca.benchmarks.harness.results import find_moved, read_results
from softdeca.benchmarks.kept import KEPT, RESULTS, SINGLE, Kept, check, judge, keep
from softdeca.benchmarks.studies import load_study
from softdeca.lhm import InputError
from softdeca.lhm.base import provenance
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.plan import PRESETS

from ..conftest import measure_here

COMMIT = "0123456789ab"
QUICK = ("material", "verification", "hard", "heads", "face-benchmark")
"""Kept results whose cheap part takes some seconds."""
SMALL = {"poisson": ("0.45",), "modes": ("one axis",)}


@pytest.fixture
def two(monkeypatch):
    """Two kept results, `material` and `another`, of a commit that is clean."""
    monkeypatch.setattr(kept, "KEPT", {"material": Kept("material", SMALL), "another": Kept("material", SMALL)})
    say_commit(monkeypatch, COMMIT)
    measure_here(monkeypatch)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with the work and the file of `material`."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as monkeypatch:
        two.__wrapped__(monkeypatch)
        monkeypatch.setattr(kept, "RESULTS", folder / "results")
        kept.RESULTS.mkdir()
        keep("material", folder / "work")
    return folder


@pytest.fixture
def small(made, two, tmp_path, monkeypatch):
    """The file of `material` in a folder that is to have `another` beside it, whose rows are there."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    shutil.copytree(tmp_path / "work" / COMMIT / "material", tmp_path / "work" / COMMIT / "another")
    monkeypatch.setattr(kept, "RESULTS", tmp_path / "results")
    return kept.RESULTS / "material.json"


def say_commit(monkeypatch, commit):
    def read():
        return commit

    read.cache_clear = lambda: None
    monkeypatch.setattr(provenance, "read_commit", read)


def change(path, edit):
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))


def test_every_file_is_a_kept_result_and_the_other_way_round():
    names = Counter(str(path.relative_to(RESULTS).with_suffix("")) for path in RESULTS.rglob("*.json"))
    assert names == Counter([*KEPT, *SINGLE])


@pytest.mark.parametrize("name", KEPT)
def test_a_study_can_be_made_and_needs_what_there_is(name):
    study = KEPT[name].make_study()
    assert set(study.needs) <= set(inputs.INPUTS) and study.allowed <= 0.01
    assert set(KEPT[name].corpora) <= set(kept.CORPORA)
    if study.cheap and not KEPT[name].files and not KEPT[name].part:
        assert 1 <= sum(study.cheap.lower() in str(task).lower() for task in study.tasks()) <= 3
    if KEPT[name].part:
        assert any(KEPT[name].part.lower() in str(task).lower() for task in study.tasks())


def test_no_answer_of_a_quick_result_of_today_has_moved():
    """Results that are stale say so; one that is not has to hold."""
    current = [name for name in QUICK if not judge(name).stale]
    assert {name: check(name).moved for name in current} == dict.fromkeys(current, ())


def test_a_result_is_kept_with_what_decided_it_and_holds(small):
    content = read_results(small)
    assert content["decided_by"] == {"study": "version 1, answers within 0.001"}
    assert provenance.list_missing(content) == []
    state = judge("material")
    assert (state.stale, state.commits) == ((), (COMMIT,)) and state.seconds > 0
    checked = check("material")
    assert (checked.unmeasured, checked.moved) == ("", ()) and checked.holds


def test_an_answer_that_moved_is_named(small):
    def grow(content):
        row = next(row for row in content["rows"] if row["method"] == "neo-Hookean")
        row["values"]["large"] *= 1.01

    change(small, grow)
    checked = check("material")
    assert checked.state.stale == () and not checked.holds
    (moved,) = checked.moved
    assert moved.startswith("nu = 0.45, one axis, neo-Hookean, at 50 % [%]: ") and " -> " in moved


def test_answers_that_differ_by_rounding_and_seconds_have_not_moved(small):
    content = read_results(small)
    anew = json.loads(small.read_text())
    for row in anew["rows"]:
        row["seconds"] *= 7.0
        row["values"]["large"] *= 1.0 + 1e-4
        row["values"]["tiny"] += 1e-6
    kind = load_study("material")
    assert find_moved(content, anew, kind) == []
    anew["rows"][0] |= {"status": "failed", "reason": "no more"}
    anew["rows"].append(anew["rows"][1] | {"method": "of today alone"})
    case = "nu = 0.45, one axis"
    assert find_moved(content, anew, kind) == [
        f"{case}, neo-Hookean: failed, no more",
        f"{case}, of today alone: not among the kept rows",
    ]


def test_of_many_lines_that_moved_one_is_told():
    content = read_results(kept.find_path("shapes"))
    anew = json.loads(json.dumps(content))
    anew["rows"] = anew["rows"][:1]
    for line in anew["rows"][0]["values"]["rows"][:3]:
        line["least_j"] -= 0.1
    (moved,) = find_moved(content, anew, load_study("shapes"))
    assert moved.endswith(", and 2 more lines") and "smallest volume ratio" in moved
    count = len(content["rows"][0]["values"]["rows"])
    del anew["rows"][0]["values"]["rows"][3:]
    assert f"{anew['rows'][0]['case']}, PD: {count} -> 3 lines" in find_moved(content, anew, load_study("shapes"))


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda content: content.pop("decided_by"), "it does not say what decided it"),
        (lambda content: content["decided_by"].update(study="version 0, answers within 0.001"), "study"),
        (lambda content: content["options"].update(poisson=["0.3"]), "poisson"),
        (lambda content: content["machine"].update(commit=f"{COMMIT}-dirty"), "clean tree"),
        (lambda content: content.update(rows=7), "it is of a form that is no more"),
    ],
)
def test_a_stale_result_says_why(small, edit, words):
    change(small, edit)
    assert judge("material").stale == (words,) and not check("material").holds


def test_another_tolerance_or_digest_makes_a_result_stale(small, monkeypatch):
    kind = load_study("material")
    monkeypatch.setattr(kind, "allowed", 0.5)
    assert judge("material").stale == ("study",)
    monkeypatch.undo()


def test_inputs_follow_the_files_of_network_and_people(tmp_path, monkeypatch):
    before = inputs.digest_network.__wrapped__(), inputs.digest_people.__wrapped__(), inputs.digest_heads.__wrapped__()
    assert before == (inputs.digest_network(), inputs.digest_people(), inputs.digest_heads())
    assert len(set(before)) == 3
    weights = bytearray(inputs.SHIPPED.read_bytes())
    weights[-1] ^= 1
    (tmp_path / "anny.safetensors").write_bytes(weights)
    monkeypatch.setattr(inputs, "SHIPPED", tmp_path / "anny.safetensors")
    folder = Path(inputs.identities.__file__).parent
    for name in ("anny.npz", "anny_within.npz"):
        shutil.copy(folder / name, tmp_path)
    with (tmp_path / "anny_within.npz").open("ab") as file:
        file.write(b"\0")
    monkeypatch.setattr(inputs.identities, "__file__", str(tmp_path / "__init__.py"))
    after = inputs.digest_network.__wrapped__(), inputs.digest_people.__wrapped__()
    assert after[0] != before[0] and after[1] != before[1]


def test_a_heads_digest_sees_a_tenth_of_a_millimetre_and_no_rounding(monkeypatch):
    fit, before = inputs.fit_head, inputs.digest_heads()

    def moved(by):
        def fit_moved(template, skin):
            head = fit(template, skin)
            return replace(head, skull_wrap=replace(head.skull_wrap, vertices=head.skull_wrap.vertices + by))

        monkeypatch.setattr(inputs, "fit_head", fit_moved)
        return inputs.digest_heads.__wrapped__()

    assert moved(1e-11) == before and moved(0.1) != before


def test_what_is_stale_is_made_first_and_what_is_of_this_code_not_again(small, tmp_path, monkeypatch):
    assert [state.name for state in kept.order_for_keeping(COMMIT)] == ["another"]
    assert [state.name for state in kept.order_for_keeping("of-other-code")] == ["another", "material"]
    keep("another", tmp_path / "work")
    assert kept.order_for_keeping(COMMIT) == []
    change(small, lambda content: content["options"].update(modes=[]))
    assert [state.name for state in kept.order_for_keeping("of-other-code")] == ["material", "another"]


def test_corpora_are_simulated_before_the_study_that_reads_them(small, tmp_path, monkeypatch):
    plan = replace(PRESETS["tiny"], identities=2, references=0, sequences=0, parameter_responses=0.0, contact=False)
    monkeypatch.setattr(kept, "CORPORA", {"spheres": kept.KeptCorpus(plan, "spheres:1")})
    monkeypatch.setitem(kept.KEPT, "another", replace(kept.KEPT["another"], corpora=("spheres",)))
    keep("another", tmp_path / "work")
    assert Corpus.open(tmp_path / "work" / COMMIT / "spheres").verify() == 2


@pytest.mark.parametrize("commit", ["0123456789ab-dirty", "not known: no git checkout"])
def test_nothing_is_kept_of_code_that_no_commit_holds(small, tmp_path, monkeypatch, commit):
    say_commit(monkeypatch, commit)
    with pytest.raises(InputError, match=f"clean tree.*this is {commit}"):
        keep("another", tmp_path / "work")
    assert not (kept.RESULTS / "another.json").exists()


def test_nothing_is_kept_of_code_that_changes_meanwhile(small, tmp_path, monkeypatch):
    commits = [COMMIT, COMMIT, "ba9876543210"]
    provenance.read_commit.cache_clear = lambda: say_commit(monkeypatch, commits[-1])
    with pytest.raises(InputError, match="another: the code changed while it was measured"):
        keep("another", tmp_path / "work")
    assert not (kept.RESULTS / "another.json").exists()


@pytest.mark.parametrize("status", ["skipped", "failed"])
def test_rows_that_are_there_are_not_lost(small, tmp_path, status):
    method = "stable neo-Hookean"
    rows = tmp_path / "work" / COMMIT / "material" / "rows.jsonl"
    lines = [json.loads(line) for line in rows.read_text().splitlines()]
    results = read_results(small)
    skipped = next(row for row in results["rows"] if row["method"] == method)
    made = kept.keep("material", tmp_path / "work")
    assert len(lines) == len(made.rows)  # nothing was measured again
    lost = [replace(row, status=status, reason="no package") if row.method == method else row for row in made.rows]
    with pytest.raises(InputError, match=f"material: not kept, since 1 rows that it has were {status}: no package"):
        kept._refuse_loss("material", replace(made, rows=tuple(lost)))
    assert skipped["status"] == "done"


def test_a_file_that_is_not_there_is_named(small, tmp_path, monkeypatch):
    monkeypatch.setattr(kept, "DATA", tmp_path)
    monkeypatch.setitem(kept.KEPT, "dial", KEPT["dial"])
    with pytest.raises(InputError, match="dial: ict_facekit.npz is not in"):
        keep("dial", tmp_path / "work")
    with pytest.raises(InputError, match="kept result 'nobody': there are material, another"):
        judge("nobody")


def test_the_command_lists_keeps_and_checks(small, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    ended = command("bench", "keep", "--list")
    stale, single, cost = (ended.out.splitlines()[place] for place in (1, -2, -1))
    assert ended.out.startswith("current  material") and stale.split() == [
        "stale",
        "another",
        *"it is not there".split(),
    ]
    assert single.startswith("single ") and ended.status == 0
    assert cost.startswith(f"1 of {2 + len(SINGLE)} are stale; they took 0 s last")
    ended = command("bench", "keep", "another")
    assert ended.status == 0 and "5 rows, 0 of them failed" in ended.out and (kept.RESULTS / "another.json").is_file()
    monkeypatch.setattr(kept, "SINGLE", {"alone": "its study is no more"})
    ended = command("bench", "check")
    assert ended.status == 0 and ended.out.endswith("every kept result holds\n")
    change(small, lambda content: content["options"].update(modes=[]))
    ended = command("bench", "check", "material", "alone")
    assert ended.status == 1 and "1 kept results are stale or moved" in ended.out
